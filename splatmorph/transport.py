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
    moved = move_centers(gaussians, flow, times)
    shapes = {
        sign: _shapes_along(gaussians, flow, sign, max(sign * t for t in times), stretch)
        for sign in (1, -1)
        if any(sign * t > 0 for t in times)
    }

    def frame(k: int) -> Gaussians:
        shape = _interpolated(shapes[1 if times[k] > 0 else -1], abs(times[k]) * KNOTS)
        quats, pushed, turns = shape[:, :4], shape[:, 4:7], shape[:, 7:]
        turned = replace(moved(k), quats=quats)
        if stretch:
            turned = replace(turned, log_scales=pushed)
        if gaussians.sh_degree:
            rotations = rotation_matrices(turns.T).permute(2, 0, 1)
            turned = replace(turned, sh=rotate_sh(gaussians.sh, rotations))
        return turned

    return frame


def _shapes_along(
    gaussians: Gaussians, flow: Flow, sign: int, reach: float, stretch: bool
) -> Tensor:
    """Shapes from t = 0 to ``reach`` and one knot more, in one direction of time: (knots, n, c).

    A shape is a quaternion and log scales, and for colours that turn the rotation P as a
    quaternion. The knot more is for the slope there; but within one unit of t none is beyond it,
    where baselines that are no flows end.
    """
    last = max(2, math.ceil(reach * KNOTS) + 1)
    stops = [sign * k / KNOTS for k in range(1, (min(last, KNOTS) if reach <= 1 else last) + 1)]
    channels = 11 if gaussians.sh_degree else 7
    shapes = gaussians.quats.new_empty(1 + len(stops), len(gaussians), channels)
    for start in range(0, len(gaussians), BLOCK):
        block = slice(start, start + BLOCK)
        _, jacobians = flow.trajectory_jacobian(gaussians.means[block], stops)
        quats, log_scales = gaussians.quats[block], gaussians.log_scales[block]
        for k, shape in enumerate(_carried(quats, log_scales, jacobians, stretch)):
            shapes[k, block] = shape[:, :channels]
    return shapes


def _carried(
    quats: Tensor, log_scales: Tensor, jacobians: Tensor, stretch: bool
) -> Iterator[Tensor]:
    """Shapes (n, 11) at t = 0 and after the Jacobians (k, n, 3, 3), which lead away from it."""
    start, scales = quats.double(), log_scales.double()
    axes, pushed, turn = start, scales, start.new_tensor([1.0, 0, 0, 0]).expand_as(start)
    yield torch.cat([axes, pushed, turn], 1)
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


def _interpolated(shapes: Tensor, place: float) -> Tensor:
    """Shapes (knots, n, c) at ``place`` in knots, on the cubics with the slopes of neighbours."""
    left = min(int(place), len(shapes) - 2)
    s = place - left
    # The cubic is linear in the knots: its weights are its values for unit vectors.
    units = torch.eye(len(shapes), dtype=torch.float64)
    (slopes,) = torch.gradient(units, dim=0, edge_order=2)
    rise = units[left + 1] - units[left]
    bend = (1 - s) * (slopes[left] - rise) + s * (rise - slopes[left + 1])
    weights = units[left] + s * (rise + (1 - s) * bend)
    near = slice(max(left - 1, 0), left + 3)
    return (weights[near].to(shapes) @ shapes[near].flatten(1)).unflatten(0, shapes.shape[1:])


COVARIANCES: Mapping[str, Transport] = MappingProxyType(
    {
        "fixed": move_centers,
        "rotate": partial(move_shapes, stretch=False),
        "full": partial(move_shapes, stretch=True),
    }
)
"""By name, what travels. Each maps splats, a flow and k times to a function of 0 … k - 1 that
gives the splats at that time, after one integration for all of them (and, beyond ``fixed``, one
more for the Jacobians at the knots)."""

DEFAULT_COVARIANCE = "full"
"""What comes closest to a known warp; the paper's is ``fixed``."""
