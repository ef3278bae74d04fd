"""What a test does with a page in a browser, whichever that is."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np


class Driven:
    """One page in a browser; how it is spoken to is said by those that inherit."""

    patience: float
    """Seconds that anything may take."""

    def close(self) -> None:
        """End the browser and remove its profile."""
        raise NotImplementedError

    def visit(self, address: str) -> None:
        """Go to an address."""
        raise NotImplementedError

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression, promises awaited."""
        raise NotImplementedError

    def click(self, x: float, y: float) -> None:
        """Press and release the mouse, in CSS pixels."""
        raise NotImplementedError

    def key(self, key: str) -> None:
        """Press and release a key that writes a character."""
        raise NotImplementedError

    def screenshot(self) -> np.ndarray:
        """The page as it is now, (height, width, 3) uint8."""
        raise NotImplementedError

    def open(self, path: Path, fragment: str = "") -> None:
        """Load a page from disk and wait until it has drawn and come to rest."""
        self.visit("about:blank")
        self.visit(f"{path.resolve().as_uri()}#{fragment}")
        self.rest()

    def rest(self) -> None:
        """Wait until the picture stands still in full quality, or the page says what is wrong."""
        self.wait(
            "document.documentElement?.dataset.drawn === 'still'"
            " || document.querySelector('#waiting.failed')"
        )

    def wait(self, condition: str) -> None:
        """Wait until a JavaScript expression is true."""
        deadline = time.monotonic() + self.patience
        while not self.evaluate(f"Boolean({condition})"):
            if time.monotonic() > deadline:
                raise TimeoutError(f"the page never reached: {condition}")
            time.sleep(0.03)

    def press(self, selector: str) -> None:
        """Click the middle of an element, which has to be what lies there."""
        x, y, hit = self.evaluate(
            f"(() => {{ const one = document.querySelector({selector!r});"
            "const { left, top, width, height } = one.getBoundingClientRect();"
            "const [x, y] = [left + width / 2, top + height / 2];"
            "return [x, y, one.contains(document.elementFromPoint(x, y))]; })()"
        )
        assert hit, f"{selector} is covered, or out of sight"
        self.click(x, y)
