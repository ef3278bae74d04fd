"""Soft two-way assignment of two sets of points, with room for points that have no partner."""

from __future__ import annotations

import torch
from torch import Tensor

ROUNDS = 3
STRICT = 4.0
"""How much cheaper than a typical best match a pair must be to be matched at all."""


def soft(costs: Tensor, outlier: float = 1.0) -> Tensor:
    """exp(-cost) scaled so that no row and no column exceeds 1: (…, n, m) -> (…, n, m).

    Sinkhorn's scaling with a slack of weight ``outlier`` in each row and column: a point whose
    pairs all cost more than 0 keeps most of its mass for itself.
    """
    kernel = torch.exp(-costs)
    column = torch.ones_like(kernel[..., :1, :])
    for _ in range(ROUNDS):
        row = 1 / (kernel @ column.mT + outlier)
        column = 1 / (row.mT @ kernel + outlier)
    return kernel.mul_(row).mul_(column)


def assign(costs: Tensor) -> Tensor:
    """The soft assignment (n, m) in which a pair must cost less than typical best pairs do.

    Matched that way are points that stand out, and few others.
    """
    best = torch.cat([costs.amin(1), costs.amin(0)])
    return soft(costs - (best.median() - STRICT))


def moments(plan: Tensor, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Of each row of a plan (n, m) over points (m, 3): mass (n,), mean (n, 3), variance (n,)."""
    columns = torch.cat([torch.ones_like(points[:, :1]), points, points.square()], 1)
    sums = plan @ columns
    mass = sums[:, 0]
    mean, square = (sums[:, 1:] / (mass[:, None] + 1e-9)).split(3, 1)
    return mass, mean, (square - mean.square()).sum(1).clamp_min(0)
