"""Inputs: what a user names on the command line, loaded with all that belongs to it."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from splatmorph import io
from splatmorph.avatars import Avatar, is_avatar, load_avatar
from splatmorph.avatars.places import find_avatar
from splatmorph.errors import ReadError
from splatmorph.gaussians import Gaussians
from splatmorph.io.offsets import lost_detail
from splatmorph.io.reading import require_file
from splatmorph.landmarks import Landmarks


@dataclass(frozen=True)
class Input:
    """A splat with the landmarks that were found or given, and what it takes to load it again."""

    path: Path
    gaussians: Gaussians
    landmarks: Landmarks | None
    files: tuple[Path, ...]
    """Every file that was read for it."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """How an avatar was posed, in JSON's types; empty for a plain splat."""
    avatar: Avatar | None = None
    """The rig behind the splat, if it has one."""

    @property
    def name(self) -> str:
        """A short name for files and titles."""
        return self.avatar.name if self.avatar else io.stem_of(self.path)

    @property
    def sha256(self) -> str:
        """Fingerprint of the files read."""
        return fingerprint(self.files)


def name_of(path: str | Path) -> str:
    """What the input at ``path`` is called, before it is read: its :attr:`Input.name`."""
    return find_avatar(path).name if is_avatar(path) else io.stem_of(path)


def load_splat(
    path: str | Path,
    *,
    frame: int | None = None,
    pose: str | Path | None = None,
    landmarks_set: str = "254",
    flame: str | Path | None = None,
    mesh: str | Path | None = None,
) -> Input:
    """Load a splat file, or an avatar's directory posed as the options say.

    An avatar brings the landmarks of its FLAME mesh; a plain splat comes without, and takes no
    notice of the options, which are those of :func:`splatmorph.avatars.load_avatar`.

    A file whose single precision has lost detail is logged as a warning.

    Raises:
        ReadError: the input can't be read.
        OptionError: the avatar can't be posed so.
    """
    path = Path(path)
    if not path.exists():
        raise ReadError(f"{path} does not exist: check the spelling and the folder")
    if not path.is_dir():
        require_file(path)
    if not is_avatar(path):
        return Input(path, _read(path), None, (path,))
    avatar = load_avatar(
        path, frame=frame, pose=pose, landmarks_set=landmarks_set, flame=flame, mesh=mesh
    )
    return Input(path, avatar.gaussians, avatar.landmarks, avatar.files, avatar.options, avatar)


def _read(path: Path) -> Gaussians:
    gaussians = io.read(path)
    if (spacing := lost_detail(gaussians)) is not None:
        logging.getLogger("splatmorph").warning(
            "%s holds its centers in single precision so far from the origin that they are "
            "rounded to %.2g, more than half of what its splats measure: export it with doubles, "
            "or nearer to the origin",
            path,
            spacing,
        )
    return gaussians


def load_input(
    path: str | Path,
    *,
    landmarks: str | Path | None = None,
    frame: int | None = None,
    pose: str | Path | None = None,
    landmarks_set: str = "254",
    flame: str | Path | None = None,
    mesh: str | Path | None = None,
) -> Input:
    """Load a splat as :func:`load_splat` does, and the landmarks that belong to it.

    Args:
        path: a file that ``splatmorph.io`` reads, or an avatar as ``splatmorph.avatars`` finds it.
        landmarks: a landmark file; without one, what the avatar's FLAME mesh gives, or
            ``<stem>.landmarks.*`` beside the input.
        frame: pose an avatar as in this frame of its track, or of that of ``pose``.
        pose: another avatar, or a ``flame_param.npz``, whose track gives the pose.
        landmarks_set: of an avatar's mesh: ``70``, ``254`` or ``dense``.
        flame: the FLAME model file or its folder.
        mesh: an avatar's vertices, in place of FLAME parameters.

    Raises:
        ReadError: the input or its landmarks can't be read.
        OptionError: the avatar can't be posed so.
        LandmarkError: the landmarks are no valid set, or lie far outside the splat.
    """
    loaded = load_splat(
        path, frame=frame, pose=pose, landmarks_set=landmarks_set, flame=flame, mesh=mesh
    )
    if landmarks is None and loaded.landmarks is None:
        landmarks = Landmarks.beside(path)
    if landmarks is None:
        return loaded
    found = Landmarks.read(landmarks)
    # The splats are without their offset, so that single precision holds them.
    found = replace(found, points=found.points - found.points.new_tensor(loaded.gaussians.offset))
    found.check_near(*bounding_box(loaded.gaussians), f"the splat {path}")
    return replace(loaded, landmarks=found)


def as_in_file(landmarks: Landmarks, gaussians: Gaussians) -> Landmarks:
    """Landmarks on loaded splats, in the coordinates of the file: with its offset."""
    offset = landmarks.points.new_tensor(gaussians.offset)
    return replace(landmarks, points=landmarks.points + offset)


def bounding_box(gaussians: Gaussians) -> tuple[Tensor, Tensor]:
    """Corners (3,) of the box that holds all but the outermost 1 % of centers on each side."""
    means = gaussians.means.double()
    means = means[:: max(1, len(means) // 100_000)]
    low, high = torch.quantile(means, means.new_tensor([0.01, 0.99]), dim=0)
    return low, high


def fingerprint(files: tuple[Path, ...]) -> str:
    """sha256 over the contents of ``files``, in their order."""
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()
