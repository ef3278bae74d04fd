"""Track: who a head is and how it moves, as ``flame_param.npz`` stores it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatmorph.avatars.flame import Pose
from splatmorph.avatars.flame_file import EXPRESSIONS, SHAPES, VERTICES
from splatmorph.avatars.teeth import TEETH_VERTICES
from splatmorph.errors import OptionError, ReadError
from splatmorph.io.arrays import read_npz

WIDTHS = {
    "expr": EXPRESSIONS,
    "rotation": 3,
    "neck_pose": 3,
    "jaw_pose": 3,
    "eyes_pose": 6,
    "translation": 3,
}
"""Columns of the properties that have a row a frame; expr may have fewer."""

USED = (*WIDTHS, "shape", "static_offset", "dynamic_offset")

JOINT_KEYS = ("rotation", "neck_pose", "jaw_pose", "eyes_pose")


@dataclass(frozen=True)
class Track:
    """T frames of one head."""

    path: Path
    shape: Tensor
    """(s,) FLAME shape coefficients of the person, s up to 300; none if the file has none."""
    static_offset: Tensor | None
    """(v, 3) displacements that make the person's mesh, metres."""
    expression: Tensor
    """(T, e)"""
    joints: Tensor
    """(T, 5, 3) axis-angle, radians: root, neck, jaw, two eyes."""
    translation: Tensor
    """(T, 3) metres."""
    dynamic_offset: Tensor | None
    """(T, v, 3) displacements by frame, metres; None where they are all zero."""

    def __len__(self) -> int:
        return len(self.joints)

    def pose(self, frame: int) -> Pose:
        """How the head is posed in frame ``frame``, with that frame's offsets.

        Raises:
            OptionError: no such frame.
        """
        if not 0 <= frame < len(self):
            raise OptionError(
                f"{self.path} has frames 0 to {len(self) - 1}, not {frame}: choose one of them"
            )
        offset = None if self.dynamic_offset is None else self.dynamic_offset[frame]
        return Pose(self.expression[frame], self.joints[frame], self.translation[frame], offset)

    @staticmethod
    def read(path: str | Path) -> Track:
        """Read ``flame_param.npz``. Only ``expr`` and ``jaw_pose`` must be there to move a head.

        Raises:
            ReadError: missing, no ``.npz``, shapes that disagree, NaN, or no frame at all.
        """
        path = Path(path)
        stored = _load(path)
        for key in ("expr", "jaw_pose"):
            if key not in stored:
                raise ReadError(
                    f"{path} has no '{key}' (it has {', '.join(sorted(stored)) or 'nothing'}), "
                    "expected the flame_param.npz of GaussianAvatars"
                )
        frames = len(stored["jaw_pose"]) if stored["jaw_pose"].ndim else 0
        if frames == 0:
            raise ReadError(f"{path} is a track of 0 frames, expected at least one: track it again")
        rows = {key: _rows(path, stored, key, frames) for key in WIDTHS}
        joints = torch.cat([rows[key] for key in JOINT_KEYS], dim=1).unflatten(1, (-1, 3))
        return Track(
            path=path,
            shape=_shape(path, stored),
            static_offset=_static_offset(path, stored),
            expression=rows["expr"],
            joints=joints,
            translation=rows["translation"],
            dynamic_offset=_dynamic_offset(path, stored, frames),
        )


def _load(path: Path) -> Mapping[str, NDArray[Any]]:
    stored = read_npz(path, what=".npz of a track")
    for key, value in stored.items():
        if key in USED and value.dtype.kind not in "iuf":
            raise ReadError(f"{path} has '{key}' of {value.dtype}, expected numbers")
        # A sum is finite only if every term is, and costs no mask.
        if value.dtype.kind != "f" or np.isfinite(value.sum(dtype=np.float64)):
            continue
        bad = ~np.isfinite(value)
        if bad.any():
            first = tuple(int(i) for i in np.argwhere(bad)[0])
            raise ReadError(
                f"{path} has {int(bad.sum())} NaN or infinite values in '{key}' (the first at "
                f"{list(first)}), expected finite: track the video again or cut those frames out"
            )
    return stored


def _rows(path: Path, stored: Mapping[str, NDArray[Any]], key: str, frames: int) -> Tensor:
    width = WIDTHS[key]
    if key not in stored:
        return torch.zeros(frames, width, dtype=torch.float64)
    value = stored[key]
    narrower = key == "expr" and value.ndim == 2 and value.shape[1] < width
    if value.shape != (frames, width) and not (narrower and len(value) == frames):
        raise ReadError(
            f"{path} has '{key}' of shape {value.shape}, expected ({frames}, {width}), since "
            f"'jaw_pose' has {frames} frames"
        )
    return _tensor(value)


def _shape(path: Path, stored: Mapping[str, NDArray[Any]]) -> Tensor:
    shape = stored.get("shape", np.zeros(0)).squeeze()
    if shape.ndim != 1 or len(shape) > SHAPES:
        raise ReadError(
            f"{path} has 'shape' of shape {shape.shape}, expected up to {SHAPES} coefficients"
        )
    return _tensor(shape)


def _static_offset(path: Path, stored: Mapping[str, NDArray[Any]]) -> Tensor | None:
    if "static_offset" not in stored:
        return None
    offset = stored["static_offset"]
    offset = offset[0] if offset.ndim == 3 and len(offset) == 1 else offset
    _require_head(path, "static_offset", offset.shape, ())
    return _tensor(offset)


def _dynamic_offset(path: Path, stored: Mapping[str, NDArray[Any]], frames: int) -> Tensor | None:
    offset = stored.get("dynamic_offset")
    if offset is None:
        return None
    _require_head(path, "dynamic_offset", offset.shape, (frames,))
    return _tensor(offset) if offset.any() else None


def _require_head(path: Path, key: str, found: tuple[int, ...], leading: tuple[int, ...]) -> None:
    heads = [(*leading, vertices, 3) for vertices in (VERTICES, VERTICES + TEETH_VERTICES)]
    if found not in heads:
        raise ReadError(
            f"{path} has '{key}' of shape {found}, expected {heads[0]}, or {heads[1]} with teeth"
        )


def _tensor(values: NDArray[Any]) -> Tensor:
    return torch.from_numpy(values.astype(np.float64))
