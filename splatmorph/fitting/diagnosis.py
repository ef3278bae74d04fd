"""What can be told about a fit: how it ended, what the warp does, which landmarks contradict."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping

import torch
from torch import Tensor

from splatmorph.errors import LandmarkError
from splatmorph.fitting.choice import suspects
from splatmorph.fitting.report import SMOOTHING, FitReport
from splatmorph.flows import Node
from splatmorph.geometry.alignment import similarity_between

MISSED = 1e-2
"""Largest error of a landmark, frame units, above which it is said to be missed: 0.5 % of the
box's longest side, about a splat."""
MISSED_BY_FAR = 0.03
"""Error of a landmark, as a part of the box's longest side, that spoils a morph …"""
MANY = 0.1
"""… where so large a part of them have it."""
SQUEEZED = 0.05
"""det ∂Φ/∂x below which the warp is said to squeeze."""
COINCIDE = 5e-3
"""Landmarks so close together, frame units, are one place …"""
STRETCH = 20.0
"""… and so many times that apart are two."""
UNEVEN = 4.0
"""Times the median error that no smoothing asks for."""
MOST_NAMED, MOST_TORN = 8, 5
APART_DEGREES, APART_TIMES, APART_SIZES = 20.0, 1.5, 0.4
"""A turn, a change of size and a move, in radii, that a stationary flow follows badly."""


def contradictions(p: Tensor, q: Tensor, names: tuple[str, ...]) -> list[str]:
    """Which landmarks p, q (k, dim), frame coordinates, the others contradict, as sentences."""
    lines = []
    if found := [names[i] for i in suspects(p, q)]:
        one = len(found) == 1
        more = f" and {len(found) - MOST_NAMED} more" if len(found) > MOST_NAMED else ""
        lines.append(
            f"landmark{'' if one else 's'} {', '.join(found[:MOST_NAMED])}{more} "
            f"{'is' if one else 'are'} not where the others say: misplaced, or exchanged with "
            "another"
        )
    for i, j in _torn(p, q)[:MOST_TORN]:
        lines.append(
            f"landmarks {names[i]} and {names[j]} all but coincide on one side and lie apart on "
            "the other: one of them is misplaced"
        )
    return lines


def _torn(p: Tensor, q: Tensor) -> list[tuple[int, int]]:
    """Pairs of landmarks within ``COINCIDE`` on either side, far from it on the other."""
    torn = set()
    for near, far in ((p, q), (q, p)):
        for start in range(0, len(near), 512):
            block = slice(start, start + 512)
            close = torch.cdist(near[block], near) < COINCIDE
            apart = torch.cdist(far[block], far) > STRETCH * COINCIDE
            rows = torch.nonzero(close & apart).tolist()
            torn |= {(start + i, j) for i, j in rows if start + i < j}
    return sorted(torn)


def standing_apart(report: FitReport, p: Tensor, q: Tensor) -> list[str]:
    """Whether landmarks p, q (k, dim) are missed, and stand apart as wholes: at most a sentence."""
    if next(iter(report.errors.values())) <= MISSED * report.scale:
        return []
    try:
        frame = similarity_between(p, q)
    except LandmarkError as error:
        return [str(error)]
    middle = p.cpu().double().mean(0)
    size = float((p.cpu().double() - middle).norm(dim=1).max())
    moved = float((frame(middle) - middle).norm()) / size
    grown = abs(math.log(frame.scale))
    if frame.degrees < APART_DEGREES and grown < math.log(APART_TIMES) and moved < APART_SIZES:
        return []
    line = (
        f"the target stands apart as a whole (turned {frame.degrees:.0f}°, {frame.scale:.3g} times "
        f"as large, moved by {moved:.2g} of its radius), which no flow follows well: fit to it in "
        "the source's place (Landmarks.similarity_to says where it stands), and tell the morph its "
        "frame"
    )
    logging.getLogger("splatmorph").warning(line)
    return [line]


def status_of(report: FitReport, *, asked: bool) -> str:
    """How a fit ended, in a line; ``asked`` says whether its smoothing was given, not chosen."""
    how = "interrupted, the best so far is kept: " if report.interrupted else ""
    size, count = 2 * report.scale, len(report.errors)
    if missed_by_far(report) and not asked:
        return f"{how}not met: {_missed(report.errors, MISSED_BY_FAR * size)}"
    near = MISSED * report.scale
    errors = sorted(report.errors.values())
    if errors[-1] <= near:
        return f"{how}landmarks met"
    if report.smoothing <= SMOOTHING:
        return how + _missed(report.errors, near)
    why = "as asked" if asked else "as far as they predict one another"
    smoothed = f"{how}landmarks smoothed, {why}: {errors[count // 2]:.2g} away (median)"
    # What is missed by choice is missed evenly.
    far = max(near, UNEVEN * errors[count // 2])
    return smoothed if errors[-1] <= far else f"{smoothed}; {_missed(report.errors, far)}"


def _missed(errors: Mapping[str, float], least: float) -> str:
    far = [f"{name} by {error:.3g}" for name, error in errors.items() if error > least]
    return (
        f"{len(far)} of {len(errors)} landmarks missed by more than {least:.2g}, worst "
        f"{', '.join(far[:3])}"
    )


def missed_by_far(report: FitReport) -> bool:
    """Whether more than a tenth of the landmarks are missed by more than 3 % of the object."""
    far = sum(error > MISSED_BY_FAR * 2 * report.scale for error in report.errors.values())
    return far > MANY * len(report.errors)


def choose_steps(flow: Node, points: Tensor, tolerance: float) -> int:
    """Fewest Runge-Kutta steps a unit of t whose error over ``points`` is below ``tolerance``.

    The error at 2s steps is told from s and 2s: fourth order leaves a fifteenth of the gap.
    Frame units; steps double from 4 up to 64.
    """
    steps, coarse = 4, flow.unit_forward(points, 1.0)
    for steps in (4, 8, 16, 32, 64):
        flow.steps = steps
        fine = flow.unit_forward(points, 1.0)
        if steps > 4 and float((fine - coarse).norm(dim=1).max()) / 15 < tolerance:
            break
        coarse = fine
    return steps
