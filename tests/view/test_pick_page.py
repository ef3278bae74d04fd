"""The picker's page in a real browser: hands, keys, and what the files hold in the end."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from pick_cases import STRAIGHT
from pick_visit import Visit

from splatmorph.io import read
from splatmorph.landmarks import Landmarks
from splatmorph.registration.masks import without_masked
from splatmorph.runs.request import fit_run
from splatmorph.runs.settings import Finding


@pytest.fixture
def visit(visits: Callable[..., Visit]) -> Visit:
    return visits("ines", "otto")


def test_twelve_features_clicked_are_where_they_are_and_the_fit_meets_them(visit, tmp_path):
    names = visit.pick_features()
    visit.key("s", "KeyS", control=True)
    assert visit.browser.evaluate("document.getElementById('done').open")
    assert "splatmorph fit" in visit.browser.evaluate(
        "document.getElementById('command').textContent"
    )
    visit.saved(names)
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


@pytest.mark.parametrize("shape", ["b", "k"])
def test_what_is_ringed_is_left_out_and_cleared(visit, shape):
    """A box and a loop round the lower half: both by a key, a drag, and undone by a button."""
    (left, top), (right, bottom) = visit.box(0)
    low = top + 0.6 * (bottom - top)
    corners = [(left + 2, low), (right - 2, low), (right - 2, bottom - 2), (left + 2, bottom - 2)]
    whole = read(visit.paths[0])
    visit.key(shape)
    assert visit.browser.evaluate("document.querySelectorAll('[aria-pressed=true]').length") == 2
    visit.drag(*(corners[::2] if shape == "b" else corners))
    assert "left out" in visit.browser.evaluate("document.getElementById('said').textContent")
    seen = without_masked(whole, visit.paths[0]).means[:, 1]
    assert 0.3 * len(whole) < len(seen) < 0.9 * len(whole)
    assert (seen.min() > whole.means[:, 1].min()) or (seen.max() < whole.means[:, 1].max())
    assert visit.rows() == []
    visit.browser.evaluate("document.getElementById('unmask').click()")
    visit.quiet()
    assert len(without_masked(whole, visit.paths[0])) == len(whole)
    assert visit.browser.complaints() == []


def test_a_chain_has_a_tab_for_each_pair_and_the_same_names(visits, tmp_path):
    visit = visits("ines", "otto", "ines")
    tabs = "[...document.querySelectorAll('#tabs button')]"
    assert visit.browser.evaluate(f"{tabs}.map((tab) => tab.textContent)") == [
        "ines → otto",
        "otto → ines-2",
    ]
    visit.pick("nose_tip")
    visit.browser.evaluate(f"{tabs}[1].click()")
    visit.quiet()
    visit.leg = 1
    visit.key("Tab")
    visit.click(1, "nose_tip")
    assert visit.off(2, "nose_tip", visit.rows()[0]) < 2e-3
    chosen = visit.browser.evaluate(f"{tabs}.map((tab) => tab.getAttribute('aria-selected'))")
    assert chosen == ["false", "true"]
    visit.key("s", "KeyS", control=True)
    names = {Landmarks.read(path.with_suffix(".landmarks.json")).names for path in visit.paths}
    assert names == {("p1",)}
    assert visit.browser.complaints() == []


@pytest.mark.parametrize("size", [(820, 1180), (1180, 820)])
def test_on_a_tablet_all_is_in_reach_and_a_finger_picks(visit, size):
    visit.browser.resize(*size, mobile=True)
    try:
        visit.open()
        wide = visit.browser.evaluate("document.documentElement.scrollWidth")
        assert wide <= size[0]
        for pane in (0, 1):
            (left, top), (right, bottom) = visit.box(pane)
            assert min(right - left, bottom - top) > 250
            visit.tap(pane, "nose_tip")
        for button in ("undo", "redo", "suggest", "box", "lasso", "unmask", "help", "save"):
            box = visit.browser.evaluate(
                f"(({{ left, right, top, bottom }}) => [left, right, top, bottom])"
                f"(document.getElementById('{button}').getBoundingClientRect())"
            )
            assert 0 <= box[0] < box[1] <= size[0]
            assert 0 <= box[2] < box[3] <= size[1]
        (row,) = visit.rows()
        assert all(visit.off(pane, "nose_tip", row) < 2e-3 for pane in (0, 1))
        assert visit.browser.complaints() == []
    finally:
        visit.browser.resize(1300, 760)
