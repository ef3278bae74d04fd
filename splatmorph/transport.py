"""What a flow does to splats: centers travel, and shape and shading with them if asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

import torch
from torch import Tensor

from splatmorph.covariance import polar_rotation, rotation_matrices, stretched_axes
from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians
from splatmorph.quaternions import from_matrices, product
from splatmorph.sh import rotate_sh

BLOCK = 1 << 12
"""Splats whose shapes are carried at a time, through all times: what they need stays in cache."""

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

    P is the rotation in the polar decomposition of J = ∂Φ/∂x; colours turn by it in both.
    """
    path, jacobians = flow.trajectory_jacobian(gaussians.means, times)
    shapes = _Shapes.like(gaussians, len(times))
    for start in range(0, len(gaussians), BLOCK):
        _carry(gaussians, jacobians, times, shapes, slice(start, start + BLOCK), stretch)

    def frame(k: int) -> Gaussians:
        turns = rotation_matrices(shapes.turns[k].T).permute(2, 0, 1)
        return replace(
            gaussians,
            means=path[k],
            quats=shapes.quats[k],
            log_scales=shapes.log_scales[k],
            sh=rotate_sh(gaussians.sh, turns),
        )

    return frame


@dataclass(frozen=True)
class _Shapes:
    """What changes beside the centers, at every time and for every splat."""

    quats: Tensor  # (T, n, 4)
    log_scales: Tensor  # (T, n, 3)
    turns: Tensor  # (T, n, 4) the rotations P

    @staticmethod
    def like(gaussians: Gaussians, count: int) -> _Shapes:
        quats, log_scales = gaussians.quats, gaussians.log_scales
        return _Shapes(
            quats.new_empty(count, *quats.shape),
            log_scales.expand(count, -1, -1).clone(),
            quats.new_empty(count, *quats.shape),
        )


def _carry(
    gaussians: Gaussians,
    jacobians: Tensor,
    times: Sequence[float],
    shapes: _Shapes,
    block: slice,
    stretch: bool,
) -> None:
    quats, log_scales = gaussians.quats[block].double(), gaussians.log_scales[block].T.double()
    # Outward from t = 0 in both directions, so that each moment begins at the axes before it.
    for sign in (1, -1):
        axes, turn = quats, quats.new_tensor([1.0, 0, 0, 0])
        ahead = [k for k, t in enumerate(times) if sign * t > 0]
        for k in sorted(ahead, key=lambda k: abs(times[k])):
            jacobian = jacobians[k, block].double().permute(1, 2, 0).contiguous()
            rotation = polar_rotation(jacobian)
            turned = from_matrices(rotation.permute(2, 0, 1))
            turn = turned * torch.where((turned * turn).sum(-1, keepdim=True) < 0, -1, 1)
            if stretch:
                stretching = (rotation[:, :, None] * jacobian[:, None]).sum(0)
                axes, pushed = stretched_axes(stretching, quats.T, log_scales, axes.T)
                axes, shapes.log_scales[k, block] = axes.T, pushed.T
            shapes.quats[k, block] = product(turn, axes).to(shapes.quats)
            shapes.turns[k, block] = turn.to(shapes.turns)


COVARIANCES: Mapping[str, Transport] = MappingProxyType(
    {
        "fixed": move_centers,
        "rotate": partial(move_shapes, stretch=False),
        "full": partial(move_shapes, stretch=True),
    }
)
"""By name, what travels. Each maps splats, a flow and k times to a function of 0 … k - 1 that
gives the splats at that time, after one integration for all of them."""
