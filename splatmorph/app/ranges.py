"""What numbers the options take: checked when the command line is parsed, in one place."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Any

LARGEST = 1e9
"""Of numbers that have no range of their own."""

RANGES: Mapping[str, tuple[float, float]] = {
    "anchors": (0, 1000),
    "azimuth": (-36_000, 36_000),
    "count": (8, 1_000_000),
    "elevation": (-89, 89),
    "fps": (0.1, 1000),
    "frame": (0, 10_000_000),
    "frames": (1, 100_000),
    "landmarks_count": (4, 1_000_000),
    "max_pixels": (1, 10_000_000_000),
    "max_splats": (1, 100_000_000),
    "orbit": (-36_000, 36_000),
    "port": (1, 65_535),
    "seconds": (0.01, 86_400),
    "seed": (0, 2**63 - 1),
    "seeds": (0, 100_000),
    "smoothing": (0, 1e6),
    "split": (1.001, 1000),
    "steps": (1, 1_000_000),
    "workers": (1, 1024),
}
"""By the option's name, both ends allowed."""


class RangeError(Exception):
    """A number that an option doesn't take."""


def check_ranges(arguments: Mapping[str, Any]) -> None:
    """Refuse what lies outside an option's range, NaN above all.

    Raises:
        RangeError: the line names the option.
    """
    for name, value in _numbers(arguments):
        low, high = RANGES.get(name, (-LARGEST, LARGEST))
        if not low <= value <= high:
            shown = f"{value:.6g}" if math.isfinite(value) and abs(value) < LARGEST else value
            option = name.replace("_", "-")
            raise RangeError(f"--{option} is {shown}, expected {low:.12g} to {high:.12g}")


def _numbers(arguments: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    for name, value in arguments.items():
        if dataclasses.is_dataclass(value):
            yield from _numbers(vars(value))
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield name, value
