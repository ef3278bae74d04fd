"""What a flow does to splats: centers travel, and shape and shading with them if asked."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import torch
from torch import Tensor

from splatmorph.covariance import polar_rotation, rotation_matrices, stretched_axes
from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians
from splatmorph.quaternions import from_matrices, product
from splatmorph.sh import rotate_sh

KNOTS = 8
"""Moments a unit of t at which shapes are worked out; in between they are interpolated."""

BLOCK = 1 << 13
"""Splats whose Jacobians are held at a time."""

CHANNELS = (4, 3, 4)
"""A shape at a moment: quaternion, log scales, and the rotation P as a quaternion."""

Frames = Callable[[int], Gaussians]
Transport = Callable[[Gaussians, Flow, Sequence[float]], Frames]


@torch.no_grad()
def move_centers(gaussians: Gaussians, flow: Flow, times: Sequence[float]) -> Frames:
    """The paper's transport: centers follow the flow, covariance and colour stay as they are."""
    path = flow.trajectory(gaussians.means, times)
    return lambda k: replace(gaussians, means=path[k])


@torch.no_grad()
def move_shapes(
    gaussians: Gaussians, flow: Flow, times: Sequence[float], *, stretch: bool
) -> Frames:
    """Splats turn with the flow, Σ' = P Σ Pᵀ, or with ``stretch`` take its whole J Σ Jᵀ.

    P is the rotation in the polar decomposition of J = ∂Φ/∂x; colours turn by it in both. The
    shapes are exact at the knots k/KNOTS, and in between on the cubics through them.
    """
    signs = [sign for sign in (1, -1) if any(sign * t > 0 for t in times)]
    knots = {sign: _knots(max(sign * t for t in times)) for sign in signs}
    stops = [*times, *(sign * k / KNOTS for sign in signs for k in knots[sign])]
    path = gaussians.means.new_empty(len(times), len(gaussians), 3)
    shapes = {
        sign: gaussians.quats.new_empty(len(knots[sign]), len(gaussians), sum(CHANNELS))
        for sign in signs
    }
    for start in range(0, len(gaussians), BLOCK):
        block = slice(start, start + BLOCK)
        moved, jacobians = flow.trajectory_jacobian(gaussians.means[block], stops)
        path[:, block] = moved[: len(times)]
        quats, log_scales = gaussians.quats[block], gaussians.log_scales[block]
        sides = jacobians[len(times) :].split([len(knots[sign]) for sign in signs])
        for sign, side in zip(signs, sides, strict=True):
            for k, shape in enumerate(_carried(quats, log_scales, side, stretch)):
                shapes[sign][k, block] = shape
    slopes = {sign: torch.gradient(shapes[sign], dim=0, edge_order=2)[0] for sign in signs}

    def frame(k: int) -> Gaussians:
        sign = 1 if times[k] > 0 else -1
        place = abs(times[k]) * KNOTS
        left = min(int(place), len(knots[sign]) - 2)
        ends = slice(left, left + 2)
        shape = _cubic(shapes[sign][ends], slopes[sign][ends], place - left)
        quats, pushed, turns = shape.split(CHANNELS, dim=-1)
        moved = replace(gaussians, means=path[k], quats=quats)
        if stretch:
            moved = replace(moved, log_scales=pushed)
        if gaussians.sh_degree:
            rotations = rotation_matrices(turns.T).permute(2, 0, 1)
            moved = replace(moved, sh=rotate_sh(gaussians.sh, rotations))
        return moved

    return frame


def _knots(reach: float) -> range:
    """Knots from 0 to ``reach`` and one more, for the slope; but within one unit of t if it is."""
    last = max(2, math.ceil(reach * KNOTS) + 1)
    return range((min(last, KNOTS) if reach <= 1 else last) + 1)


def _carried(
    quats: Tensor, log_scales: Tensor, jacobians: Tensor, stretch: bool
) -> Iterator[Tensor]:
    """Shapes (n, 11) after each of the Jacobians (k, n, 3, 3), which lead away from t = 0."""
    start, scales = quats.double(), log_scales.double()
    axes, pushed, turn = start, scales, start.new_tensor([1.0, 0, 0, 0])
    for jacobian in jacobians:
        jacobian = jacobian.double().permute(1, 2, 0).contiguous()
        rotation = polar_rotation(jacobian)
        turned = from_matrices(rotation.permute(2, 0, 1))
        turn = turned * torch.where((turned * turn).sum(-1, keepdim=True) < 0, -1, 1)
        if stretch:
            # The search begins at the axes of the moment before, so they neither flip nor swap.
            stretching = (rotation[:, :, None] * jacobian[:, None]).sum(0)
            axes, pushed = (x.T for x in stretched_axes(stretching, start.T, scales.T, axes.T))
        yield torch.cat([product(turn, axes), pushed, turn], 1)


def _cubic(ends: Tensor, slopes: Tensor, s: float) -> Tensor:
    """The cubic with those two ends, (2, …) at s = 0 and 1, and those slopes there: (…)."""
    rise = ends[1] - ends[0]
    bend = (1 - s) * (slopes[0] - rise) + s * (rise - slopes[1])
    return ends[0] + s * (rise + (1 - s) * bend)


COVARIANCES: Mapping[str, Transport] = MappingProxyType(
    {
        "fixed": move_centers,
        "rotate": partial(move_shapes, stretch=False),
        "full": partial(move_shapes, stretch=True),
    }
)
"""By name, what travels. Each maps splats, a flow and k times to a function of 0 … k - 1 that
gives the splats at that time, after one integration for all of them."""
