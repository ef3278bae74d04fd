"""How a target stands beside its source, in words."""

from __future__ import annotations

import math

from torch import Tensor

from splatmorph.geometry.similarity import Similarity

LEAST_DEGREES, LEAST_GROWTH, LEAST_SHIFT = 1.0, 0.01, 0.01
"""A turn, a change of size and, as a part of the size, a move that are worth a word."""
NEARLY = 1.4
"""Objects of one kind differ less than this many times in size."""
UNITS = {10: "mm against cm?", 100: "cm against m?", 1000: "mm against m?"}
ALONG = math.cos(math.radians(15))
"""Closer to an axis than this it is that axis."""


def standing(frame: Similarity, points: Tensor, offset: Tensor | None = None) -> str | None:
    """What ``frame`` does to the source's landmarks (k, dim); None where that is nothing.

    ``offset`` (dim,) is what the target's coordinates are beyond the source's besides, world
    units. One line: "turned 87° about x, 3.1 times as large, moved 0.42 away".
    """
    middle = points.mean(0)
    size = 2 * float((points - middle).norm(dim=1).max())
    apart = frame(middle) - middle
    moved = float((apart if offset is None else apart + offset).norm())
    said = []
    if frame.degrees >= LEAST_DEGREES:
        about = f" about {_axis(frame.axis)}" if frame.dim == 3 else ""
        said.append(f"turned {frame.degrees:.0f}°{about}")
    if abs(math.log(frame.scale)) >= LEAST_GROWTH:
        said.append(f"{frame.scale:.3g} times as large")
    if moved >= LEAST_SHIFT * size * max(1.0, frame.scale):
        said.append(f"moved {moved:.3g} away")
    if not said:
        return None
    return "target: " + ", ".join(said) + _other_units(frame.scale)


def _axis(axis: Tensor) -> str:
    along = int(axis.abs().argmax())
    if float(axis[along].abs()) > ALONG:
        return ("-" if axis[along] < 0 else "") + "xyz"[along]
    return "(" + ", ".join(f"{value:.2g}" for value in axis.tolist()) + ")"


def _other_units(scale: float) -> str:
    larger, smaller = ("target", "source") if scale > 1 else ("source", "target")
    times = max(scale, 1 / scale)
    for factor, units in UNITS.items():
        if factor / NEARLY < times < factor * NEARLY:
            return f"; the {larger} is about {factor} times the {smaller} ({units})"
    return ""
