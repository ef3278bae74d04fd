"""What a flow does to splats: centers travel, and shape and shading with them if asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
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
from splatmorph.morph.paths import Drift, Path, for_each_block, paths_of
from splatmorph.steady import one_thread


class Frames(Protocol):
    """The splats at the k-th time; what it can, it makes in ``room``, of as many splats."""

    def __call__(self, k: int, room: Gaussians | None = None) -> Gaussians: ...


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
    path = flow.trajectory(gaussians.means, times)

    @one_thread()
    def frame(k: int, room: Gaussians | None = None) -> Gaussians:
        if drift is None:
            return replace(gaussians, means=path[k])
        outs = (None, None) if room is None else (room.means, room.sh)
        ways = (path[k], drift.offset), (gaussians.sh, drift.sh)
        means, sh = (
            torch.add(start, way.to(start), alpha=abs(times[k]), out=out)
            for (start, way), out in zip(ways, outs, strict=True)
        )
        return replace(gaussians, means=means, sh=sh)

    return frame


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

    P is the rotation in the polar decomposition of J = ∂Φ/∂x; colours turn by it in both. Centers
    and shapes are exact at the knots k/KNOTS, and in between on the cubics through them.
    """
    ways = {sign: [abs(t) for t in times if sign * t > 0] for sign in (1, -1)}
    paths = {
        sign: paths_of(gaussians, flow, sign, own, stretch=stretch, drift=drift)
        for sign, own in ways.items()
        if own
    }

    def frame(k: int, room: Gaussians | None = None) -> Gaussians:
        near, weights = paths[1 if times[k] > 0 else -1].about(abs(times[k]))
        own = None if drift is None else (drift.sh.to(gaussians.sh), abs(times[k]))
        degree = gaussians.sh_degree
        arguments = near, weights, gaussians.sh, degree, own
        if native.takes(near, gaussians.sh, degree):
            made = native.moment(*arguments, None if room is None else vars(room))
        else:
            made = moment(*arguments)
        changed: dict[str, Any] = {**made}
        return replace(gaussians, **changed)

    return frame


def moment(
    paths: Mapping[str, Path],
    weights: Tensor,
    sh: Tensor,
    degree: int,
    drift: tuple[Tensor, float] | None,
) -> dict[str, Tensor]:
    """What splats are between knots; the plain twin of the C++ in ``native/moment.h``.

    Arguments:
        paths: by name what changes, at the knots about the moment.
        weights: (near,) of those.
        sh, degree: the colours at the start, (n, (degree + 1)², 3).
        drift: what the colours drift by, of the shape of ``sh``, and how much of it.

    Returns:
        what has changed, and ``sh``: turned by ``turns``, where they are among the paths.
    """
    changed = {name: path.at(weights) for name, path in paths.items()}
    turns = changed.pop("turns", None)
    changed["sh"] = sh if drift is None else torch.add(sh, drift[0], alpha=drift[1])
    if turns is not None:
        changed["sh"] = rotate_sh(changed["sh"], to_matrices(turns))
    return changed


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

    def work_out(block: slice, _: Tensor, jacobians: Tensor) -> None:
        turned = polar_rotation(jacobians[0].double().permute(1, 2, 0).contiguous())
        turns[block] = turned.permute(2, 0, 1).float()

    for_each_block(work_out, flow, gaussians.means, [t])
    return turns


COVARIANCES: Mapping[str, Transport] = MappingProxyType(
    {
        "fixed": move_centers,
        "rotate": partial(move_shapes, stretch=False),
        "full": partial(move_shapes, stretch=True),
    }
)
"""By name, what travels. Each maps splats, a flow and k times to a function of 0 … k - 1 that
gives the splats at that time, after one integration for all of them."""

DEFAULT_COVARIANCE = "full"
"""What comes closest to a known warp; the paper's is ``fixed``."""
