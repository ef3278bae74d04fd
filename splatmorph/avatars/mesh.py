"""A head's mesh from a file, in place of FLAME parameters."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatmorph.avatars.flame_file import FACES, VERTICES, read_flame
from splatmorph.avatars.teeth import TEETH_FACES, TEETH_VERTICES, teeth_faces
from splatmorph.errors import ReadError
from splatmorph.io.arrays import read_npy
from splatmorph.io.elements import read_layout
from splatmorph.io.reading import reading, require_file

MESHES = ("obj", "ply")
LARGEST = 64 << 20
"""Bytes of a mesh file; FLAME's has a hundredth."""


def read_mesh(path: Path, faces: Path | None, flame: Path | None) -> tuple[Tensor, Tensor]:
    """Vertices (V, 3) float64 and faces (F, 3) of a head of FLAME topology, teeth or not.

    Arguments:
        path: ``.npy`` with the vertices, or a mesh file (``.obj``, ``.ply``).
        faces: ``.npy`` with the faces, for a file without any.
        flame: the FLAME model file, for its faces, where there is no other source.

    Raises:
        ReadError: missing, damaged, of another topology, NaN, or without faces from anywhere.
    """
    vertices, own = _read_npy(path, "fiu"), None
    if vertices is None:
        vertices, own = _read_with_trimesh(path)
    if vertices.ndim == 3 and len(vertices) == 1:
        vertices = vertices[0]
    if vertices.shape not in ((VERTICES, 3), (VERTICES + TEETH_VERTICES, 3)):
        raise ReadError(
            f"{path} has vertices of shape {vertices.shape}, expected ({VERTICES}, 3), or "
            f"({VERTICES + TEETH_VERTICES}, 3) with teeth: give the FLAME mesh that the avatar "
            "was trained on, its vertices neither merged nor split"
        )
    if not np.isfinite(vertices).all():
        raise ReadError(f"{path} has NaN or infinite vertices, expected finite: export it again")
    if own is None and faces is not None:
        own, path = _read_npy(faces, "iu"), faces
    if own is None and flame is not None:
        own, path = read_flame(flame).faces, flame
    if own is None:
        raise ReadError(
            f"{path} has vertices but no faces: put faces.npy ({FACES}, 3) beside it, give a mesh "
            "with faces (.obj, .ply), or give FLAME by `flame`"
        )
    return torch.from_numpy(vertices.astype(np.float64)), _checked(own, path, len(vertices))


def _checked(faces: NDArray[Any], path: Path, vertices: int) -> Tensor:
    if faces.shape == (FACES, 3) and vertices > VERTICES:
        faces = np.concatenate([faces, teeth_faces()])
    most = FACES if vertices == VERTICES else FACES + TEETH_FACES
    if faces.shape != (most, 3) or faces.min() < 0 or faces.max() >= vertices:
        raise ReadError(
            f"{path} has faces of shape {faces.shape} up to vertex {faces.max(initial=0)}, "
            f"expected ({most}, 3) below {vertices}: give the faces of FLAME in their own order"
        )
    return torch.from_numpy(faces.astype(np.int64))


def _read_npy(path: Path, kinds: str) -> NDArray[Any] | None:
    """The array of a ``.npy`` file of numbers; None where the extension is another."""
    if path.suffix.lower() != ".npy":
        return None
    array = read_npy(path)
    if array.dtype.kind not in kinds:
        raise ReadError(f"{path} holds {array.dtype}, expected numbers of a mesh")
    return array


def _read_with_trimesh(path: Path) -> tuple[NDArray[Any], NDArray[Any] | None]:
    kind = path.suffix.lower().removeprefix(".")
    if kind not in MESHES:
        raise ReadError(f"{path} is no mesh that we read, expected .npy, .obj or .ply")
    require_file(path)
    if path.stat().st_size > LARGEST:
        raise ReadError(f"{path} is larger than {LARGEST >> 20} MB, expected a head's mesh")
    if kind == "ply":
        read_layout(path)
    else:
        _check_corners(path)
    import trimesh

    with reading(path, "mesh"), path.open("rb") as stream:
        # Unprocessed: merged or reordered vertices would no longer be FLAME's. From a stream,
        # so that no file is opened that this one names.
        mesh: Any = trimesh.load(
            stream, file_type=kind, process=False, maintain_order=True, force="mesh"
        )
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    return vertices, faces if len(faces) else None


def _check_corners(path: Path) -> None:
    """Refuse an ``.obj`` whose faces have corners beyond its lines: room is made up to them."""
    with reading(path, "mesh"):
        data = path.read_bytes()
        lines = data.count(b"\n") + data.count(b"\r") + 1
        for face in re.finditer(rb"^[ \t]*f\b[^\r\n]*", data, re.MULTILINE):
            if any(int(corner) > lines for corner in re.findall(rb"\d+", face[0])):
                raise ReadError(f"{path} has faces beyond its own vertices: export it again")
