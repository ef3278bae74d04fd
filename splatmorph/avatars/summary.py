"""What an avatar is, said before anything is done with it: for ``splatmorph inspect``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from splatmorph.avatars.flame_file import FACES
from splatmorph.avatars.places import STEPS, find_avatar, find_flame
from splatmorph.avatars.rig import read_local
from splatmorph.avatars.track import Track
from splatmorph.errors import ReadError


@dataclass(frozen=True)
class AvatarSummary:
    """Facts of an avatar's files; FLAME itself is looked for but not opened."""

    name: str
    splats_file: Path
    splats: int
    sh_degree: int
    faces_bound: int
    """How many faces of the mesh carry splats."""
    teeth: bool
    """Whether splats are bound to the teeth of GaussianAvatars."""
    track_file: Path | None
    frames: int | None
    """Frames of the track, numbered from 0; None without one."""
    mesh_file: Path | None
    flame_file: Path | None
    """The FLAME model that would be used; None where none was found."""
    hint: str | None
    """What is missing to bake it, and how to get it; None if nothing is."""


def summarize(
    path: str | Path, *, flame: str | Path | None = None, mesh: str | Path | None = None
) -> AvatarSummary:
    """Look at an avatar's files, without needing FLAME.

    Raises:
        ReadError: no avatar, or a damaged file.
    """
    places = find_avatar(path, mesh)
    local, binding = read_local(places.splats)
    track = Track.read(places.track) if places.track is not None else None
    hint = None
    try:
        model = find_flame(flame, near=places.splats)
    except ReadError as error:
        model, hint = None, str(error)
    if track is None and places.mesh is None:
        hint = (
            "neither flame_param.npz nor mesh_verts.npy lies beside the splats: copy the one it "
            "was trained with there, or give `mesh`"
        )
    elif track is not None and mesh is None and model is None:
        hint = hint or f"FLAME was not found; {STEPS}"
    return AvatarSummary(
        name=places.name,
        splats_file=places.splats,
        splats=len(local),
        sh_degree=local.sh_degree,
        faces_bound=len(binding.unique()),
        teeth=int(binding.max()) >= FACES,
        track_file=places.track,
        frames=len(track) if track is not None else None,
        mesh_file=places.mesh,
        flame_file=model,
        hint=hint,
    )
