"""What can be told about a fit: how it ended, what the warp does, which landmarks contradict."""

from __future__ import annotations

import torch
from torch import Tensor

from splatmorph.flows import Node

STRETCH = 20.0
"""Neighbouring landmarks that come this many times closer or farther contradict each other."""
MISSED = 1e-2
"""Largest error of a landmark, frame units, above which it is said to be missed: 0.5 % of the
box's longest side, about a splat."""
SQUEEZED = 0.05
"""det ∂Φ/∂x below which the warp is said to squeeze."""
MOST_WARNINGS = 5


def contradictions(p: Tensor, q: Tensor, names: tuple[str, ...]) -> list[str]:
    """Neighbours on one side that lie far apart on the other, as sentences, the worst first."""
    found: dict[tuple[int, int], float] = {}
    for near, far in ((p, q), (q, p)):
        for i, j, ratio in _torn(near, far):
            pair = (min(i, j), max(i, j))
            found[pair] = max(found.get(pair, 0.0), ratio)
    worst = sorted(found, key=lambda pair: -found[pair])
    lines = [
        f"landmarks {names[i]} and {names[j]} are {float((p[i] - p[j]).norm()):.3g} apart in the "
        f"source and {float((q[i] - q[j]).norm()):.3g} in the target: one of them is misplaced"
        for i, j in worst[:MOST_WARNINGS]
    ]
    if len(worst) > MOST_WARNINGS:
        lines.append(f"and {len(worst) - MOST_WARNINGS} more pairs of landmarks like these")
    return lines


def _torn(near: Tensor, far: Tensor) -> list[tuple[int, int, float]]:
    torn = []
    count = min(3, len(near) - 1)
    for start in range(0, len(near), 512):
        block = torch.cdist(near[start : start + 512], near)
        distance, neighbour = block.topk(count + 1, largest=False)
        gap = (far[start : start + 512, None] - far[neighbour]).norm(dim=2)
        ratio = gap / distance.clamp_min(1e-12)
        for row, column in torch.nonzero(ratio > STRETCH).tolist():
            i, j = start + row, int(neighbour[row, column])
            if i != j:
                torn.append((i, j, float(ratio[row, column])))
    return torn


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
