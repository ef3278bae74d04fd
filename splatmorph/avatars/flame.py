"""FLAME: a head's mesh from shape, expression and pose (Li et al. 2017)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from splatmorph.avatars.flame_file import JOINTS, VERTICES, FlameArrays, read_flame
from splatmorph.avatars.teeth import TEETH_VERTICES, with_teeth
from splatmorph.errors import ReadError
from splatmorph.geometry.quaternions import matrices_from_axis_angles


@dataclass(frozen=True)
class Pose:
    """What moves: one frame, or a batch (...) of them. Angles in radians, metres."""

    expression: Tensor
    """(..., e) coefficients, as many as are known; those that follow are 0."""
    joints: Tensor
    """(..., 5, 3) axis-angle rotations of root, neck, jaw and the two eyes."""
    translation: Tensor
    """(..., 3) of the whole head."""
    offset: Tensor | None = None
    """(..., v, 3) displacements of the vertices before the joints move them."""

    @staticmethod
    def canonical() -> Pose:
        """No expression, no rotation: mouth closed, looking along +z."""
        return Pose(*(torch.zeros(shape, dtype=torch.float64) for shape in ((0,), (JOINTS, 3), 3)))


class Flame(nn.Module):
    """v(β, ψ, θ): linear shape, expression and pose correctives, then linear blend skinning.

    ``rest`` gives the person and ``forward`` the person in a pose. Any (V, 3) mesh of the topology
    can be posed: a mesh between two persons is one more person. Everything is float64 and
    differentiable.
    """

    template: Tensor
    shapes: Tensor
    expressions: Tensor
    poses: Tensor
    regressor: Tensor
    weights: Tensor
    faces: Tensor

    def __init__(self, arrays: FlameArrays) -> None:
        super().__init__()
        for name in ("template", "shapes", "expressions", "poses", "regressor", "weights", "faces"):
            self.register_buffer(
                name, torch.from_numpy(np.ascontiguousarray(getattr(arrays, name)))
            )
        self.parents = arrays.parents

    @staticmethod
    def read(path: Path, *, teeth: bool) -> Flame:
        """The user's FLAME file, with the teeth of GaussianAvatars or without.

        The file is large and two avatars share it, so the last ones read are kept.

        Raises:
            ReadError: see ``read_flame``.
        """
        modified = path.stat().st_mtime_ns if path.is_file() else 0
        return _read(path.resolve(), modified, teeth)

    def rest(self, shape: Tensor, offset: Tensor | None = None) -> Tensor:
        """The person (V, 3): template + shapes · β + offset, in the canonical pose.

        Arguments:
            shape: (s,) coefficients β, as many as are known.
            offset: (v, 3) of the first v vertices, for V or for a head without teeth.

        Raises:
            ReadError: more coefficients or vertices than the model has.
        """
        return _offset(self.template + _blend(self.shapes, shape, "shape"), offset)

    def forward(self, rest: Tensor, pose: Pose) -> Tensor:
        """The person ``rest`` (V, 3) in a pose: (..., V, 3).

        Joints are regressed from the shaped mesh; each vertex, corrected by the entries of
        R_j - I of the four joints below the root, follows the weighted mean of the rigid motions
        of the joints (SMPL, Loper et al. 2015, eq. 2, 4, 9).

        Raises:
            ReadError: more coefficients or vertices than the model has.
        """
        shaped = rest + _blend(self.expressions, pose.expression, "expression")
        shaped = _offset(shaped, pose.offset)
        places = torch.einsum("jv,...vc->...jc", self.regressor, shaped)
        rotations = matrices_from_axis_angles(pose.joints.double())
        feature = (rotations[..., 1:, :, :] - torch.eye(3, dtype=torch.float64)).flatten(-3)
        corrected = shaped + torch.einsum("vcp,...p->...vc", self.poses, feature)
        turned, moved = self._chain(rotations, places)
        skin = torch.einsum("vj,...jab->...vab", self.weights, turned)
        carried = (skin @ corrected[..., None]).squeeze(-1)
        carried = carried + torch.einsum("vj,...jc->...vc", self.weights, moved)
        return carried + pose.translation.double()[..., None, :]

    def _chain(self, rotations: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
        """World rotations (..., 5, 3, 3) and translations (..., 5, 3) that the joints apply."""
        turned = [rotations[..., 0, :, :]]
        stands = [places[..., 0, :]]
        for joint in range(1, len(self.parents)):
            parent = self.parents[joint]
            arm = places[..., joint, :] - places[..., parent, :]
            stands.append(stands[parent] + (turned[parent] @ arm[..., None]).squeeze(-1))
            turned.append(turned[parent] @ rotations[..., joint, :, :])
        world = torch.stack(turned, dim=-3)
        return world, torch.stack(stands, dim=-2) - (world @ places[..., None]).squeeze(-1)


@lru_cache(maxsize=2)
def _read(path: Path, modified: int, teeth: bool) -> Flame:
    arrays = read_flame(path)
    return Flame(with_teeth(arrays) if teeth else arrays)


def _blend(directions: Tensor, coefficients: Tensor, what: str) -> Tensor:
    known, most = coefficients.shape[-1], directions.shape[-1]
    if known > most:
        raise ReadError(f"{known} {what} coefficients, but the FLAME model has {most}")
    return torch.einsum("vcs,...s->...vc", directions[..., :known], coefficients.double())


def _offset(vertices: Tensor, offset: Tensor | None) -> Tensor:
    if offset is None:
        return vertices
    given, most = offset.shape[-2], vertices.shape[-2]
    # Teeth come last: a head without them drops their offsets, a head with them has none known.
    if given != most and {given, most} != {VERTICES, VERTICES + TEETH_VERTICES}:
        raise ReadError(f"offsets of {given} vertices, but the FLAME model has {most}")
    known = min(given, most)
    moved = vertices[..., :known, :] + offset[..., :known, :].double()
    return torch.cat([moved, vertices[..., known:, :].expand(*moved.shape[:-2], -1, -1)], dim=-2)
