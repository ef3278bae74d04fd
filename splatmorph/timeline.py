"""Timeline: how an animation in one file plays."""

from __future__ import annotations

import math
from dataclasses import dataclass

from splatmorph.errors import OptionError


@dataclass(frozen=True)
class Timeline:
    """How long an animation plays, and in what units."""

    seconds: float = 4.0
    """How long an animation in one file (USD) plays."""
    fps: float = 30.0
    """Its frames a second."""
    metres_per_unit: float = 1.0
    """Metres in a unit of the splats, for USD."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 < value < math.inf:
                raise OptionError(f"`{name}` is {value:g}, expected a finite number above 0")

    def codes(self, count: int) -> list[float]:
        """Time codes of ``count`` samples, evenly from the first to the last frame."""
        last = self.seconds * self.fps
        return [last * i / max(1, count - 1) for i in range(count)]


STILL = Timeline()
