"""Triangle frames: where a splat that is bound to a face of a mesh stands in the world."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from splatmorph.gaussians import Gaussians
from splatmorph.geometry import quaternions

SHORTEST = 1e-9
"""Lengths below this are no length: metres, far below any edge of a head."""


@dataclass(frozen=True)
class Frames:
    """F similarities x ↦ k R x + c, local → world: one a face."""

    rotations: Tensor
    """(F, 3, 3) R, columns the axes in the world."""
    scales: Tensor
    """(F,) k > 0, world units a local unit."""
    centers: Tensor
    """(F, 3) c, world units."""

    def inverse(self) -> Frames:
        """World → local."""
        back = self.rotations.mT
        return Frames(back, 1 / self.scales, -_rotate(back, self.centers) / self.scales[:, None])

    def after(self, first: Frames) -> Frames:
        """``first``, then these: carries splats from one pose of a mesh into another."""
        moved = self.scales[:, None] * _rotate(self.rotations, first.centers) + self.centers
        return Frames(self.rotations @ first.rotations, self.scales * first.scales, moved)

    def apply(self, gaussians: Gaussians, binding: Tensor) -> Gaussians:
        """Every splat by the similarity of its face: position, size and rotation.

        Opacity and SH stay. SH coefficients of an avatar are trained in the posed world frame,
        so no triangle turns them.

        Arguments:
            gaussians: n splats.
            binding: (n,) the face of each.
        """
        scales = self.scales[binding, None]
        means = scales * _rotate(self.rotations[binding], gaussians.means.double())
        turns = quaternions.from_matrices(self.rotations)[binding]
        quats = quaternions.product(turns, quaternions.normalized(gaussians.quats.double()))
        log_scales = gaussians.log_scales.double() + scales.log()
        return replace(
            gaussians,
            means=(means + self.centers[binding]).to(gaussians.means.dtype),
            quats=quats.to(gaussians.quats.dtype),
            log_scales=log_scales.to(gaussians.log_scales.dtype),
        )


def triangle_frames(vertices: Tensor, faces: Tensor) -> Frames:
    """The frame of every face, as GaussianAvatars (Qian et al. 2024, section 3.2) lays it.

    For corners v0 v1 v2: a0 along v1 - v0, a1 the normal, a2 = -(a1 × a0); R = [a0 a1 a2];
    k the mean of the edge |v1 - v0| and the height |a2 · (v2 - v0)|; c the centroid. Where a
    triangle has no direction (corners that coincide or lie on a line) any orthogonal axes stand
    in for it, so that nothing becomes NaN.

    Arguments:
        vertices: (V, 3) world units; computed in float64.
        faces: (F, 3) vertex indices.
    """
    v0, v1, v2 = vertices.double()[faces].unbind(1)
    edge, side = v1 - v0, v2 - v0
    a0 = _directions(edge, _directions(side, edge.new_tensor([1.0, 0.0, 0.0])))
    a1 = _directions(torch.linalg.cross(a0, side), _perpendicular(a0))
    a2 = -torch.linalg.cross(a1, a0)
    scales = (torch.linalg.vector_norm(edge, dim=1) + (a2 * side).sum(1).abs()) / 2
    return Frames(
        rotations=torch.stack([a0, a1, a2], dim=-1),
        scales=scales.clamp(min=SHORTEST),
        centers=(v0 + v1 + v2) / 3,
    )


def _rotate(rotations: Tensor, points: Tensor) -> Tensor:
    return (rotations @ points[:, :, None]).squeeze(-1)


def _directions(vectors: Tensor, otherwise: Tensor) -> Tensor:
    length = torch.linalg.vector_norm(vectors, dim=1, keepdim=True)
    return torch.where(length > SHORTEST, vectors / length.clamp(min=SHORTEST), otherwise)


def _perpendicular(directions: Tensor) -> Tensor:
    """A unit vector (m, 3) orthogonal to each: across the axis it is least aligned with."""
    least = torch.zeros_like(directions)
    least.scatter_(1, directions.abs().argmin(1, keepdim=True), 1.0)
    across = torch.linalg.cross(directions, least)
    return across / torch.linalg.vector_norm(across, dim=1, keepdim=True)
