"""What a flow does to splats: centers travel, and shape and shading with them if asked."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any, Protocol

import torch
from torch import Tensor

from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import rotate_sh
from splatmorph.geometry.quaternions import to_matrices
from splatmorph.morph.covariance import carried_shapes, polar_rotation
from splatmorph.morph.native import moment as native
from splatmorph.morph.native import shapes
from splatmorph.steady import one_thread

KNOTS = 8
"""Moments a unit of t at which shapes are worked out; in between they are interpolated."""

BLOCK = 1 << 15
"""Splats whose Jacobians are held at a time."""


class Frames(Protocol):
    """The splats at the k-th time; what it can, it makes in ``room``, of as many splats."""

    def __call__(self, k: int, room: Gaussians | None = None) -> Gaussians: ...


@dataclass(frozen=True)
class Drift:
    """What becomes of splats beyond the flow, each of it times |t|: all at the other end."""

    offset: Tensor
    """(n, 3) world units, added to where the flow takes the centers."""
    slope: Tensor
    """(n, 3, 3) the derivative of the offset by the centers at t = 0, added to that of the flow."""
    sh: Tensor
    """(n, k, 3) added to the coefficients of the colours, before they turn with their splats."""


class Transport(Protocol):
    """Maps splats, a flow and k times to a function of 0 … k - 1 that gives the splats then."""

    def __call__(
        self, gaussians: Gaussians, flow: Flow, times: Sequence[float], drift: Drift | None = None
    ) -> Frames: ...


@torch.no_grad()
def move_centers(
    gaussians: Gaussians, flow: Flow, times: Sequence[float], drift: Drift | None = None
) -> Frames:
    """The paper's transport: centers follow the flow, covariance and colour stay as they are."""
    centers = _centers(gaussians, flow, times, drift)

    def frame(k: int, room: Gaussians | None = None) -> Gaussians:
        sh = gaussians.sh
        if drift is not None:
            out = None if room is None else room.sh
            sh = torch.add(sh, drift.sh.to(sh), alpha=abs(times[k]), out=out)
        return replace(gaussians, means=centers(k, room), sh=sh)

    return frame


def _centers(
    gaussians: Gaussians, flow: Flow, times: Sequence[float], drift: Drift | None
) -> Callable[[int, Gaussians | None], Tensor]:
    path = flow.trajectory(gaussians.means, times)

    @one_thread()
    def centers(k: int, room: Gaussians | None) -> Tensor:
        if drift is None:
            return path[k]
        out = None if room is None else room.means
        return torch.add(path[k], drift.offset.to(path[k]), alpha=abs(times[k]), out=out)

    return centers


@torch.no_grad()
def move_shapes(
    gaussians: Gaussians,
    flow: Flow,
    times: Sequence[float],
    drift: Drift | None = None,
    *,
    stretch: bool,
) -> Frames:
    """Splats turn with the flow, Σ' = P Σ Pᵀ, or with ``stretch`` take its whole J Σ Jᵀ.

    P is the rotation in the polar decomposition of J = ∂Φ/∂x; colours turn by it in both. The
    shapes are exact at the knots k/KNOTS, and in between on the cubics through them.
    """
    centers = _centers(gaussians, flow, times, drift)
    reaches = {sign: max(sign * t for t in times) for sign in (1, -1)}
    paths = {
        sign: _shapes_along(gaussians, flow, sign, reach, stretch, drift)
        for sign, reach in reaches.items()
        if reach > 0
    }

    def frame(k: int, room: Gaussians | None = None) -> Gaussians:
        near, weights = _about(paths[1 if times[k] > 0 else -1], abs(times[k]) * KNOTS)
        own = None if drift is None else (drift.sh.to(gaussians.sh), abs(times[k]))
        degree = gaussians.sh_degree
        arguments = near, weights, gaussians.sh, degree, own
        if native.takes(near, gaussians.sh, degree):
            shape = native.moment(*arguments, None if room is None else vars(room))
        else:
            shape = moment(*arguments)
        changed: dict[str, Any] = {**shape}
        return replace(gaussians, means=centers(k, room), **changed)

    return frame


def moment(
    paths: Mapping[str, Tensor],
    weights: Tensor,
    sh: Tensor,
    degree: int,
    drift: tuple[Tensor, float] | None,
) -> dict[str, Tensor]:
    """What splats are between knots; the plain twin of the C++ in ``native/moment.h``.

    Arguments:
        paths: by name what changes, (near, n, c) at the knots about the moment.
        weights: (near,) of those.
        sh, degree: the colours at the start, (n, (degree + 1)², 3).
        drift: what the colours drift by, of the shape of ``sh``, and how much of it.

    Returns:
        what has changed, and ``sh``: turned by ``turns``, where they are among the paths.
    """
    shape = {
        name: (weights.to(path) @ path.flatten(1)).reshape(path.shape[1:])
        for name, path in paths.items()
    }
    turns = shape.pop("turns", None)
    shape["sh"] = sh if drift is None else torch.add(sh, drift[0], alpha=drift[1])
    if turns is not None:
        shape["sh"] = rotate_sh(shape["sh"], to_matrices(turns))
    return shape


def _shapes_along(
    gaussians: Gaussians,
    flow: Flow,
    sign: int,
    reach: float,
    stretch: bool,
    drift: Drift | None,
) -> dict[str, Tensor]:
    """Shapes from t = 0 to ``reach`` and one knot more, in one direction of time.

    By the name of what changes, (knots, n, c): the quaternions, the log scales where they do,
    and for colours that turn the rotation P as a quaternion. The knot more is for the slope
    there; but within one unit of t none is beyond it, where baselines that are no flows end.
    """
    last = max(2, math.ceil(reach * KNOTS) + 1)
    stops = [sign * k / KNOTS for k in range(1, (min(last, KNOTS) if reach <= 1 else last) + 1)]
    quats, log_scales = gaussians.quats, gaussians.log_scales
    unturned = quats.new_tensor([1.0, 0.0, 0.0, 0.0]).expand_as(quats)
    starts = {"quats": quats, "log_scales": log_scales, "turns": unturned}
    changing = {"quats": True, "log_scales": stretch, "turns": gaussians.sh_degree > 0}
    paths = {
        name: start.new_empty(1 + len(stops), *start.shape)
        for name, start in starts.items()
        if changing[name]
    }
    for name, path in paths.items():
        path[0] = starts[name]
    for block, jacobians in jacobian_blocks(flow, gaussians.means, stops):
        if drift is not None:
            ways = jacobians.new_tensor(stops).abs()[:, None, None, None]
            jacobians = jacobians + ways * drift.slope[block].to(jacobians)
        own = quats[block], log_scales[block], jacobians
        takes = shapes.takes(quats, jacobians, stretch=stretch)
        carried = (shapes.carried_shapes if takes else carried_shapes)(*own, stretch=stretch)
        for name, moments in zip(starts, carried, strict=True):
            if name in paths:
                paths[name][1:, block] = moments
    return paths


def drifted(gaussians: Gaussians, drift: Drift, *, stretch: bool) -> Gaussians:
    """Splats with all of their drift, where they stand."""
    jacobians = (torch.eye(3).to(drift.slope) + drift.slope).to(gaussians.quats)[None]
    quats, log_scales, _ = carried_shapes(
        gaussians.quats, gaussians.log_scales, jacobians, stretch=stretch
    )
    return replace(
        gaussians,
        means=gaussians.means + drift.offset,
        quats=quats[0] if stretch else gaussians.quats,
        log_scales=log_scales[0] if stretch else gaussians.log_scales,
        sh=gaussians.sh + drift.sh,
    )


@torch.no_grad()
def colour_turns(gaussians: Gaussians, flow: Flow, t: float, covariance: str) -> Tensor | None:
    """(n, 3, 3) the rotations P that colours turn by until t; None where they don't."""
    if not gaussians.sh_degree or covariance == "fixed":
        return None
    turns = torch.empty(len(gaussians), 3, 3)
    for block, jacobians in jacobian_blocks(flow, gaussians.means, [t]):
        turned = polar_rotation(jacobians[0].double().permute(1, 2, 0).contiguous())
        turns[block] = turned.permute(2, 0, 1).float()
    return turns


def jacobian_blocks(
    flow: Flow, points: Tensor, times: Sequence[float]
) -> Iterator[tuple[slice, Tensor]]:
    """∂Φ/∂x at ``points`` (n, 3) after k ``times``, block by block: which points, (k, m, 3, 3)."""
    for begin in range(0, len(points), BLOCK):
        block = slice(begin, begin + BLOCK)
        yield block, flow.trajectory_jacobian(points[block], times)[1]


def _about(paths: Mapping[str, Tensor], place: float) -> tuple[dict[str, Tensor], Tensor]:
    """The knots of paths (knots, n, c) about ``place`` in knots, at most four, and their weights.

    What is between them lies on cubics with the slopes of neighbours.
    """
    knots = len(next(iter(paths.values())))
    left = min(int(place), knots - 2)
    s = place - left
    # The cubic is linear in the knots: its weights are its values for unit vectors.
    units = torch.eye(knots, dtype=torch.float64)
    (slopes,) = torch.gradient(units, dim=0, edge_order=2)
    rise = units[left + 1] - units[left]
    bend = (1 - s) * (slopes[left] - rise) + s * (rise - slopes[left + 1])
    weights = units[left] + s * (rise + (1 - s) * bend)
    near = slice(max(left - 1, 0), left + 3)
    return {name: path[near] for name, path in paths.items()}, weights[near]


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
