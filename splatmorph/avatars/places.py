"""Where things are: the files of an avatar as users have them, and their FLAME."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from splatmorph.errors import ReadError

FLAME_VARIABLE = "SPLATMORPH_FLAME"
FLAME_NAMES = ("flame2023.pkl", "generic_model.pkl")
EMBEDDING_NAME = "landmark_embedding_with_eyes.npy"
CHECKOUT = Path("flame_model", "assets", "flame")
"""Where a checkout of GaussianAvatars has FLAME; avatars often lie inside one."""

SPLATS_NAME, TRACK_NAME, FACES_NAME = "point_cloud.ply", "flame_param.npz", "faces.npy"
MESH_NAMES = ("mesh_verts.npy", "mesh.obj", "mesh.ply")
LONGEST_HEADER = 1 << 16


@dataclass(frozen=True)
class Places:
    """The files that make one avatar."""

    splats: Path
    track: Path | None
    """``flame_param.npz`` beside the splats."""
    mesh: Path | None
    """Vertices of the head beside the splats, or as given."""
    faces: Path | None
    """``faces.npy`` beside the mesh, or one folder up."""

    @property
    def name(self) -> str:
        """What people call it: the folder that they keep it in."""
        return own_folder(self.splats).name or self.splats.stem


def find_avatar(path: str | Path, mesh: str | Path | None = None) -> Places:
    """The files of the avatar at ``path``.

    Arguments:
        path: the splat file, its directory, or the model directory with
            ``point_cloud/iteration_<N>``, of which the largest N counts.
        mesh: vertices to use in place of those beside the splats.

    Raises:
        ReadError: nothing there, or no triangle-local splat file.
    """
    path = Path(path)
    splats = _find_splats(path)
    if splats is None:
        if not path.exists():
            raise ReadError(f"{path} does not exist: check the spelling and the folder")
        raise ReadError(
            f"{path} holds no {SPLATS_NAME} and no point_cloud/iteration_N folder, expected an "
            "avatar of GaussianAvatars: give its directory or its splat file"
        )
    if not is_local(splats):
        raise ReadError(
            f"{splats} has no property binding_0: it is a splat in world space or no splat at all, "
            "expected a triangle-local avatar; a world-space splat needs no baking and no FLAME"
        )
    folder = splats.parent
    if mesh is not None and not Path(mesh).is_file():
        raise ReadError(f"the mesh {mesh} does not exist: check the spelling and the folder")
    found = Path(mesh) if mesh is not None else _first(folder / name for name in MESH_NAMES)
    return Places(
        splats=splats,
        track=_first([folder / TRACK_NAME]),
        mesh=found,
        faces=found and _first([found.parent / FACES_NAME, found.parent.parent / FACES_NAME]),
    )


def own_folder(splats: Path) -> Path:
    """The folder that is the avatar: above ``point_cloud/iteration_N``, where there are these."""
    folder = splats.resolve().parent
    while folder.name == "point_cloud" or re.fullmatch(r"iteration_\d+", folder.name):
        folder = folder.parent
    return folder


def is_avatar(path: str | Path) -> bool:
    """Whether ``path`` is, or holds, a triangle-local splat. Reads one header at most."""
    splats = _find_splats(Path(path))
    return splats is not None and is_local(splats)


def is_local(path: Path) -> bool:
    """Whether the header of a PLY file binds its splats to faces."""
    try:
        with path.open("rb") as stream:
            head = stream.read(LONGEST_HEADER)
    except OSError:
        return False
    header = head.partition(b"end_header")[0]
    return head.startswith(b"ply") and re.search(rb"\sbinding_0\s", header) is not None


def find_flame(given: str | Path | None, *, near: Path | None = None) -> Path | None:
    """The user's FLAME model file, or None.

    It is looked for in what was given, in ``SPLATMORPH_FLAME`` (either the file or its folder)
    and, above the avatar of the splats ``near``, in a checkout of GaussianAvatars. Never inside
    the avatar's own folder: that is a download like any other.

    Raises:
        ReadError: something was given, and FLAME is not there.
    """
    for origin, named in (("`flame`", given), (FLAME_VARIABLE, os.environ.get(FLAME_VARIABLE))):
        if not named:
            continue
        place = Path(named).expanduser()
        found = _first([place] if place.is_file() else [place / name for name in FLAME_NAMES])
        if found is None:
            raise ReadError(
                f"{origin} says {named}, but there is no {' or '.join(FLAME_NAMES)}; {STEPS}"
            )
        return found
    return _first(folder / name for folder in _checkouts(near) for name in FLAME_NAMES)


def find_embedding(flame: str | Path | None, *, near: Path) -> Path:
    """The file of the 70 landmarks: beside FLAME or the avatar, or in a checkout.

    Raises:
        ReadError: it is nowhere; the line says where it comes from.
    """
    named = [Path(place).expanduser() for place in (flame, os.environ.get(FLAME_VARIABLE)) if place]
    folders = [place.parent if place.suffix else place for place in named]
    folders += [near.parent, *_checkouts(near)]
    found = _first(folder / EMBEDDING_NAME for folder in folders)
    if found is None:
        raise ReadError(
            f"the 70 landmarks need {EMBEDDING_NAME}, which was not found: copy it from "
            f"{CHECKOUT} of github.com/ShenhanQian/GaussianAvatars into the folder of "
            f"{FLAME_VARIABLE} or `flame`, or choose `landmarks_set` 254, which needs no file"
        )
    return found


STEPS = (
    "to get it: register at https://flame.is.tue.mpg.de, download 'FLAME 2023', unpack "
    f"{FLAME_NAMES[0]} into any folder, and give that folder by `flame` or in the environment "
    f"variable {FLAME_VARIABLE}"
)


def _find_splats(path: Path) -> Path | None:
    if path.is_file():
        return path
    if (path / SPLATS_NAME).is_file():
        return path / SPLATS_NAME
    iterations = {
        int(found[1]): folder / SPLATS_NAME
        for root in (path / "point_cloud", path)
        if root.is_dir()
        for folder in root.iterdir()
        if (found := re.fullmatch(r"iteration_(\d+)", folder.name))
        and (folder / SPLATS_NAME).is_file()
    }
    return iterations[max(iterations)] if iterations else None


def _checkouts(near: Path | None) -> Iterator[Path]:
    for folder in own_folder(near).parents if near else ():
        yield folder / CHECKOUT


def _first(candidates: Iterable[Path]) -> Path | None:
    return next((candidate for candidate in candidates if candidate.is_file()), None)
