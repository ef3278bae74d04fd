"""A hand at the picker's page in a headless Chromium."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from browser import Browser

from splatmorph.landmarks import Landmarks
from splatmorph.view.pick import Server

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
        x, y = self.where(pane, name)
        self.mouse("mousePressed", x, y)
        self.mouse("mouseReleased", x, y)
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

    def off(self, side: int, name: str, row: dict) -> float:
        marks = self.truth[side]
        true = marks.points[marks.names.index(name)].numpy()
        return float(np.linalg.norm(np.array(row["places"][side]["point"]) - true))
