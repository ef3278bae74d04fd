"""The picker's page in a real browser: hands, keys, and what the files hold in the end."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from browser import Browser, find_browser
from pick_cases import ASIDE, ASSETS, STRAIGHT

from splatmorph.landmarks import Landmarks
from splatmorph.runs.request import fit_run
from splatmorph.runs.settings import Finding
from splatmorph.view.pick import Server, open_desk

QUIET = (
    "(async () => { let last; do { last = picker.busy; await last; } "
    "while (last !== picker.busy); })()"
)


@dataclass
class Visit:
    """A browser at a picker's page, by a hand that knows where the true marks are."""

    browser: Browser
    server: Server
    paths: list[Path]
    truth: tuple[Landmarks, Landmarks]

    def open(self, more: str = "") -> None:
        self.browser.visit(self.server.address + more)
        self.browser.wait("document.documentElement?.dataset.ready")
        assert self.browser.evaluate("document.documentElement.dataset.ready") == "yes"
        self.quiet()

    def quiet(self) -> None:
        self.browser.evaluate(QUIET)

    def where(self, pane: int, name: str) -> tuple[float, float]:
        marks = self.truth[pane]
        point = marks.points[marks.names.index(name)].tolist()
        x, y = self.browser.evaluate(
            f"(() => {{ const box = picker.panes[{pane}].root.getBoundingClientRect();"
            f"const [x, y] = picker.panes[{pane}].project({point});"
            "return [box.left + x, box.top + y]; })()"
        )
        return x, y

    def mouse(self, kind: str, x: float, y: float) -> None:
        self.browser.call(
            "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1
        )

    def click(self, pane: int, name: str) -> None:
        x, y = self.where(pane, name)
        self.mouse("mousePressed", x, y)
        self.mouse("mouseReleased", x, y)
        self.quiet()

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        self.mouse("mousePressed", *start)
        for share in (0.3, 0.7, 1.0):
            here = [a + share * (b - a) for a, b in zip(start, end, strict=True)]
            self.mouse("mouseMoved", *here)
        self.mouse("mouseReleased", *end)
        self.quiet()

    def key(self, key: str, code: str = "", *, control: bool = False, shift: bool = False) -> None:
        held = 2 * control + 8 * shift
        for kind in ("keyDown", "keyUp"):
            self.browser.call(
                "Input.dispatchKeyEvent", type=kind, key=key, code=code or key, modifiers=held
            )
        self.quiet()

    def turn(self, angle: float) -> None:
        self.browser.evaluate(
            f"picker.panes.forEach((p) => {{ p.camera.azimuth = {angle}; p.changed(); }})"
        )

    def rows(self) -> list[dict]:
        return self.browser.evaluate("picker.rows")

    def pick(self, name: str) -> None:
        """A on A, then the correction on B."""
        self.click(0, name)
        self.click(1, name)

    def off(self, pane: int, name: str, row: dict) -> float:
        marks = self.truth[pane]
        true = marks.points[marks.names.index(name)].numpy()
        return float(np.linalg.norm(np.array(row["places"][pane]["point"]) - true))


@pytest.fixture
def visit(browsers: list[Browser], tmp_path: Path) -> Iterator[Visit]:
    program = find_browser()
    if program is None:
        pytest.skip("no Chromium here (apt-get install chromium, or set SPLATMORPH_TEST_BROWSER)")
    if not browsers:
        browsers.append(Browser(program, 1300, 760, offline=False))
    paths = [Path(shutil.copy(ASSETS / f"{name}.ply", tmp_path)) for name in ("ines", "otto")]
    server = Server(open_desk(paths), "splatmorph fit ines.ply otto.ply")
    threading.Thread(target=server.serve_forever, daemon=True).start()
    truth = tuple(Landmarks.read(ASSETS / f"{name}.landmarks.json") for name in ("ines", "otto"))
    made = Visit(browsers[0], server, paths, truth)
    made.open()
    yield made
    server.shutdown()
    server.server_close()


def test_twelve_features_clicked_are_where_they_are_and_the_fit_meets_them(visit, tmp_path):
    for name in STRAIGHT:
        visit.pick(name)
    for name in ASIDE:
        visit.turn(0.0)
        visit.pick(name)
        # Once more from aside, on both: the sights are crossed.
        visit.turn(0.5 if name.endswith("left") else -0.5)
        for pane in (0, 1):
            visit.key("e")
            visit.click(pane, name)
    assert len(visit.rows()) == 12
    for row, name in zip(visit.rows(), [*STRAIGHT, *ASIDE], strict=True):
        visit.browser.evaluate(f"picker.act('rename', {{ row: {row['id']}, name: '{name}' }})")
    visit.quiet()
    visit.key("s", "KeyS", control=True)
    assert visit.browser.evaluate("document.getElementById('done').open")
    assert "splatmorph fit" in visit.browser.evaluate(
        "document.getElementById('command').textContent"
    )
    found = [Landmarks.read(path.with_suffix(".landmarks.json")) for path in visit.paths]
    for side, marks in enumerate(found):
        assert marks.names == (*STRAIGHT, *ASIDE)
        true = visit.truth[side]
        there = true.points[[true.names.index(name) for name in marks.names]]
        errors = dict(zip(marks.names, (marks.points - there).norm(dim=1).tolist(), strict=True))
        assert max(errors.values()) < 2e-3, errors
    run = fit_run(*visit.paths, out=tmp_path / "run", finding=Finding(auto=False))
    assert "met" in run.legs[0].report["status"]
    assert max(run.legs[0].report["errors"].values()) < 1e-3
    assert visit.browser.complaints() == []


def test_undo_redo_reload_and_marks_that_are_moved(visit):
    visit.pick("nose_tip")
    visit.click(0, "forehead")
    before = visit.rows()
    assert before[1]["places"][1]["guess"]
    visit.open()
    assert visit.rows() == before
    visit.key("Tab")
    visit.key("Tab")
    visit.key("Enter")
    assert not visit.rows()[1]["places"][1]["guess"]
    for _ in range(2):
        visit.key("z", "KeyZ", control=True)
    assert len(visit.rows()) == 1
    for _ in range(2):
        visit.key("z", "KeyZ", control=True, shift=True)
    assert not visit.rows()[1]["places"][1]["guess"]
    visit.key("Escape")
    start = visit.where(1, "nose_tip")
    visit.drag(start, visit.where(1, "cheek_left"))
    assert visit.off(1, "cheek_left", visit.rows()[0]) < 2e-3
    count = len(visit.rows())
    visit.drag((100.0, 600.0), (160.0, 610.0))
    assert len(visit.rows()) == count
    assert visit.browser.evaluate("picker.panes[1].camera.azimuth") != 0
    assert visit.browser.complaints() == []


def test_keys_alone_make_pairs_and_swapped_ones_turn_red(visit):
    visit.browser.evaluate("document.getElementById('pane0').focus()")
    for _ in range(4):
        visit.key("s")
        visit.key("Enter")
        visit.key("Enter")
    assert sum(place["guess"] for row in visit.rows() for place in row["places"]) == 0
    assert len(visit.rows()) == 4
    for _ in range(6):
        visit.key("ArrowUp", shift=True)
    visit.key("Enter")
    visit.key("Enter")
    assert len(visit.rows()) == 5
    visit.key("Delete")
    while visit.rows():
        visit.key("Tab")
        visit.key("Delete")
    swap = {"mouth_corner_left": "mouth_corner_right", "mouth_corner_right": "mouth_corner_left"}
    for name in [*STRAIGHT, "cheek_front_left", "cheek_front_right", "chin"]:
        visit.click(0, name)
        visit.click(1, swap.get(name, name))
    red = visit.browser.evaluate(
        "[...document.querySelectorAll('tr.bad')].map((line) => Number(line.cells[0].textContent))"
    )
    assert {6, 7} & set(red)
    assert visit.browser.complaints() == []


def test_the_morph_plays_and_pictures_stand_in_for_webgl(visit):
    for name in STRAIGHT:
        visit.pick(name)
    visit.key("t")
    visit.browser.evaluate("picker.setTime(0.5)")
    visit.browser.wait("picker.panes[1].between && pane1.dataset.drawn === 'still'")
    middle = visit.browser.screenshot()
    visit.key("t")
    visit.browser.wait("pane1.dataset.drawn === 'still'")
    other = visit.browser.screenshot()
    assert np.abs(middle.astype(int) - other).mean() > 1
    visit.open("&pictures=1")
    visit.browser.wait("pane0.dataset.drawn === 'still' && pane1.dataset.drawn === 'still'")
    drawn = visit.browser.screenshot()
    half = drawn[60:680, 10:500].astype(int), other[60:680, 10:500]
    assert np.abs(half[0] - half[1]).mean() < 8
    assert visit.browser.complaints() == []


def test_an_address_without_its_token_shows_nothing(visit):
    visit.browser.visit(visit.server.address[:-3])
    visit.browser.wait("document.body && document.body.textContent.includes('token')")
    assert visit.browser.evaluate("document.scripts.length") == 0
