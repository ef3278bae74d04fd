"""Rig: an avatar's splats on its triangles, and the mesh that moves them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatmorph.avatars.flame import Flame, Pose
from splatmorph.avatars.flame_file import FACES
from splatmorph.avatars.mesh import read_mesh
from splatmorph.avatars.places import STEPS, Places, find_avatar, find_flame
from splatmorph.avatars.teeth import TEETH_FACES
from splatmorph.avatars.track import Track
from splatmorph.avatars.triangles import triangle_frames
from splatmorph.errors import OptionError, ReadError
from splatmorph.gaussians import Gaussians
from splatmorph.io.ply import BINDING, NORMALS, gaussians_from_properties, read_properties


@dataclass(frozen=True)
class Rig:
    """One avatar as its files hold it, before any pose."""

    places: Places
    local: Gaussians
    """n splats, each in the frame of its triangle."""
    binding: Tensor
    """(n,) the face of each splat."""
    rest: Tensor
    """(V, 3) the person's mesh: in the canonical pose, or as the mesh file has it. Metres."""
    faces: Tensor
    """(F, 3)"""
    flame: Flame | None
    """What poses the mesh; None where only a mesh file is known."""
    track: Track | None
    """Who the person is and how it moved; None with a mesh file."""

    def posed(self, pose: Pose) -> Tensor:
        """The mesh (V, 3) in a pose.

        Raises:
            OptionError: only a mesh file is known, which has the one pose.
        """
        if self.flame is None:
            raise OptionError(
                f"{self.places.name} is posed by {self.places.mesh} and can't take another pose: "
                "that needs its flame_param.npz and FLAME"
            )
        with torch.no_grad():
            return self.flame(self.rest, pose)

    def bake(self, vertices: Tensor) -> Gaussians:
        """The splats in world space on the mesh ``vertices`` (V, 3)."""
        return triangle_frames(vertices, self.faces).apply(self.local, self.binding)


def read_rig(
    path: str | Path, *, flame: str | Path | None = None, mesh: str | Path | None = None
) -> Rig:
    """Read an avatar: splats, and FLAME parameters or mesh vertices.

    Arguments:
        path: the splat file, its directory or the model directory.
        flame: the FLAME model file or its folder; see ``find_flame`` for where else it may be.
        mesh: a mesh file to use in place of FLAME parameters.

    Raises:
        ReadError: a file is missing or wrong; the line says which and what to do.
    """
    places = find_avatar(path, mesh)
    local, binding = read_local(places.splats)
    if places.track is not None and mesh is None:
        return _by_parameters(places, places.track, local, binding, flame)
    if places.mesh is None:
        raise ReadError(
            f"{places.splats} lies in the frames of a head's triangles, but there is neither "
            "flame_param.npz nor mesh_verts.npy beside it: copy the one it was trained with there, "
            "or give `mesh`"
        )
    known = find_flame(flame, near=places.splats) if places.faces is None else None
    vertices, faces = read_mesh(places.mesh, places.faces, known)
    _require_faces(places.splats, binding, len(faces), f"the mesh {places.mesh}")
    return Rig(places, local, binding, vertices, faces, flame=None, track=None)


def read_local(path: Path) -> tuple[Gaussians, Tensor]:
    """The splats of a triangle-local file, in their local frames, and the face (n,) of each.

    Raises:
        ReadError: damaged, or bound to no face.
    """
    columns = read_properties(path)
    if BINDING not in columns:
        raise ReadError(f"{path} has no property {BINDING}, expected a triangle-local avatar")
    binding = _binding(path, columns)
    # Normals, where anyone wrote some, would be the triangles' own.
    rest = {name: value for name, value in columns.items() if name not in (BINDING, *NORMALS)}
    return gaussians_from_properties(rest, path), binding


def _by_parameters(
    places: Places, found: Path, local: Gaussians, binding: Tensor, flame: str | Path | None
) -> Rig:
    track = Track.read(found)
    if len(track.shape) == 0:
        raise ReadError(
            f"{found} has no 'shape', so it says how a head moves but not whose it is: expected "
            "the flame_param.npz that the avatar was trained with"
        )
    model = find_flame(flame, near=places.splats)
    if model is None:
        raise ReadError(
            f"{places.splats} needs the FLAME head model, which was not found; {STEPS}; or give "
            "the head's vertices by `mesh`"
        )
    head = Flame.read(model, teeth=int(binding.max()) >= FACES)
    _require_faces(places.splats, binding, len(head.faces), "FLAME with teeth")
    rest = head.rest(track.shape, track.static_offset)
    return Rig(places, local, binding, rest, head.faces, head, track)


def _binding(path: Path, columns: Mapping[str, NDArray[Any]]) -> Tensor:
    stored = columns[BINDING]
    bad = ~np.isfinite(stored) | (stored != np.floor(stored)) | (stored < 0)
    if bad.any():
        first = int(bad.argmax())
        raise ReadError(
            f"{path} has {int(bad.sum())} values of {BINDING} that are no face number (the first "
            f"is {stored[first]} of splat {first}), expected whole numbers from 0: export it again"
        )
    return torch.from_numpy(stored.astype(np.int64))


def _require_faces(path: Path, binding: Tensor, faces: int, what: str) -> None:
    most = int(binding.max())
    if most < faces:
        return
    toothless = faces == FACES and most < FACES + TEETH_FACES
    hint = (
        "the avatar was trained with teeth: give a mesh of 5143 vertices, or FLAME"
        if toothless
        else "the splats belong to another mesh, or the file is damaged"
    )
    raise ReadError(
        f"{path} binds {int((binding >= faces).sum())} splats to faces up to {most}, but {what} "
        f"has {faces}: {hint}"
    )
