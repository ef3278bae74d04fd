"""A hand at the picker's page in a browser."""

from __future__ import annotations

import contextlib
import shutil
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from pick_cases import ASIDE, ASSETS, STRAIGHT

from splatmorph.landmarks import Landmarks
from splatmorph.view.pick import Server, open_desk

QUIET = (
    "(async () => { let last; do { last = picker.busy; await last; } "
    "while (last !== picker.busy); })()"
)


@dataclass
class Visit:
    """A browser at a picker's page, by a hand that knows where the true marks are."""

    browser: Any
    """Driven; keys held down, dragging, touch and complaints are Chromium's alone."""
    server: Server
    paths: list[Path]
    truth: tuple[Landmarks, ...]
    leg: int = 0
    """The tab that is open."""

    def open(self, more: str = "") -> None:
        self.browser.visit(self.server.address + more)
        self.browser.wait("document.documentElement?.dataset.ready")
        assert self.browser.evaluate("document.documentElement.dataset.ready") == "yes"
        self.quiet()

    def quiet(self) -> None:
        self.browser.evaluate(QUIET)

    def where(self, pane: int, name: str) -> tuple[float, float]:
        marks = self.truth[self.leg + pane]
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
        self.browser.click(*self.where(pane, name))
        self.quiet()

    def tap(self, pane: int, name: str) -> None:
        x, y = self.where(pane, name)
        self.browser.call(
            "Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}]
        )
        self.browser.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        self.quiet()

    def box(self, pane: int) -> tuple[tuple[float, float], tuple[float, float]]:
        """The corners of a pane."""
        left, top, right, bottom = self.browser.evaluate(
            "(({ left, top, right, bottom }) => [left, top, right, bottom])"
            f"(picker.panes[{pane}].root.getBoundingClientRect())"
        )
        return (left, top), (right, bottom)

    def drag(self, *corners: tuple[float, float]) -> None:
        """Press at the first, move along them, let go at the last."""
        self.mouse("mousePressed", *corners[0])
        for start, end in pairwise(corners):
            for share in (0.3, 0.7, 1.0):
                here = [a + share * (b - a) for a, b in zip(start, end, strict=True)]
                self.mouse("mouseMoved", *here)
        self.mouse("mouseReleased", *corners[-1])
        self.quiet()

    def key(self, key: str, code: str = "", *, control: bool = False, shift: bool = False) -> None:
        self.browser.key(key, code, 2 * control + 8 * shift)
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

    def pick_features(self) -> list[str]:
        """Twelve features of the face, those on its sides from two directions, named."""
        for name in STRAIGHT:
            self.pick(name)
        for name in ASIDE:
            self.turn(0.0)
            self.pick(name)
            # Once more from aside, on both: the sights are crossed.
            self.turn(0.5 if name.endswith("left") else -0.5)
            for pane in (0, 1):
                self.browser.key("e")
                self.click(pane, name)
        names = [*STRAIGHT, *ASIDE]
        for row, name in zip(self.rows(), names, strict=True):
            self.browser.evaluate(f"picker.act('rename', {{ row: {row['id']}, name: '{name}' }})")
        self.quiet()
        return names

    def saved(self, names: list[str]) -> None:
        """What was saved are these landmarks, each where it truly is."""
        for path, truth in zip(self.paths, self.truth, strict=True):
            marks = Landmarks.read(path.with_suffix(".landmarks.json"))
            assert marks.names == tuple(names)
            there = truth.points[[truth.names.index(name) for name in names]]
            errors = dict(zip(names, (marks.points - there).norm(dim=1).tolist(), strict=True))
            assert max(errors.values()) < 2e-3, errors

    def off(self, side: int, name: str, row: dict) -> float:
        marks = self.truth[side]
        true = marks.points[marks.names.index(name)].numpy()
        return float(np.linalg.norm(np.array(row["places"][side]["point"]) - true))


@contextlib.contextmanager
def visiting(browser: Any, folder: Path, *names: str) -> Iterator[Visit]:
    """The picker's page open on copies of these samples in a folder, without landmarks."""
    paths = [
        folder / (f"{name}.ply" if name not in names[:i] else f"{name}-{i}.ply")
        for i, name in enumerate(names)
    ]
    for name, path in zip(names, paths, strict=True):
        shutil.copy(ASSETS / f"{name}.ply", path)
    truth = tuple(Landmarks.read(ASSETS / f"{name}.landmarks.json") for name in names)
    server = Server(open_desk(paths), "splatmorph fit " + " ".join(path.name for path in paths))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        visit = Visit(browser, server, paths, truth)
        visit.open()
        yield visit
    finally:
        server.shutdown()
        server.server_close()
