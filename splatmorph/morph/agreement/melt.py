"""Melt: parts without a counterpart sink into the other's surface and grow out of it.

The flow brings surfaces together where there are landmarks. What is left between them, a bun on
a bald head, is travelled on the way: a displacement, linear in time, that is smooth over the
surface, zero at the landmarks and zero where the surfaces lie on each other already.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from splatmorph.gaussians import Gaussians
from splatmorph.morph.agreement.neighbours import Neighbours, nearest, tree_of

SOLID = 0.3
"""Opacity from which a splat is part of a surface."""

SHEET = 6
"""Solid splats whose mean is the surface near a point."""

SAME = 0.02
"""Of the radius: surfaces closer than this are the same."""

REACH = (0.45, 0.7)
"""Of the radius: what is nearer melts, what is further away from the other stands alone."""

HELD = 0.04
"""Of the radius: how far a landmark holds its surroundings."""

ROUNDS = 3
"""Rounds of smoothing over the neighbours."""

STEEPEST = 0.8
"""The most that a displacement changes over a length, in that length: what melts doesn't fold."""


class Surface:
    """The solid splats, to be asked for the surface near a point."""

    def __init__(self, gaussians: Gaussians) -> None:
        means = gaussians.means.double().numpy(force=True)
        self._points = means[(gaussians.opacities > SOLID).numpy(force=True)]
        self._tree = tree_of(self._points) if len(self._points) >= SHEET else None

    def near(self, points: np.ndarray) -> np.ndarray:
        """The mean of the solid splats nearest to points (n, 3); the points where none are."""
        if self._tree is None:
            return points
        found = nearest(self._tree, points, SHEET)[1]
        flat: np.ndarray = self._points[found].mean(1)
        return flat


def offsets(
    parts: Sequence[Gaussians],
    around: Sequence[Neighbours],
    goals: Sequence[Sequence[float]],
    radius: float,
    held: Tensor,
) -> tuple[list[Tensor], list[Tensor]]:
    """Where parts go beyond the flow, from their surfaces onto the others'.

    Arguments:
        parts: the splats at the common shape, with the neighbours ``around`` them.
        goals: for each part how far it goes to each other.
        radius: of all, world units.
        held: (m, 3) the landmarks at the common shape.

    Returns:
        of each part the offsets (n, 3), and how far its splats stand alone, (n,) in [0, 1].
    """
    surfaces = [Surface(part) for part in parts]
    steps, alone = [], []
    for part, here, near, shares in zip(parts, surfaces, around, goals, strict=True):
        ways = [
            (share, *_way(part, here, there, near, radius, held))
            for share, there in zip(shares, surfaces, strict=True)
            if share
        ]
        steps.append(torch.stack([share * step for share, step, _ in ways]).sum(0))
        alone.append(torch.stack([share * lone for share, _, lone in ways]).sum(0) / sum(shares))
    return steps, alone


def _way(
    part: Gaussians, here: Surface, there: Surface, around: Neighbours, radius: float, held: Tensor
) -> tuple[Tensor, Tensor]:
    """The way (n, 3) of ``part`` from its surface onto another, and how far it is alone (n,)."""
    points = part.means.double().numpy(force=True)
    # A difference, so that of two equal splats it is exactly 0.
    step = torch.from_numpy(there.near(points) - here.near(points)).float()
    size = step.norm(dim=1, keepdim=True)
    low, high = (bound * radius for bound in REACH)
    alone = ((size - low) / (high - low)).clamp(0, 1)
    step = step * (size / (SAME * radius) - 1).clamp(0, 1) * (1 - alone)
    for _ in range(ROUNDS):
        mean = around.means(torch.cat([step, alone], 1))
        step, alone = mean[:, :3], mean[:, 3:]
    if len(held):
        away = tree_of(held.double().numpy(force=True)).query(points, workers=-1)[0]
        away = torch.from_numpy(away / (HELD * radius)).float()
        step = step * (1 - torch.exp(-0.5 * away**2))[:, None]
    return step, alone[:, 0]


def slopes(rest: Gaussians, offset: Tensor, around: Neighbours) -> Tensor:
    """∂offset/∂x (n, 3, 3) at the splats at rest, held back where it would fold them."""
    found = around.slopes(rest.means.float(), offset)
    size: Tensor = torch.linalg.matrix_norm(found)[:, None, None]
    return found * (STEEPEST / size.clamp_min(1e-12)).clamp_max(1)
