"""The FLAME model file that the user downloaded, as checked arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splatmorph.avatars.stand_ins import as_array
from splatmorph.avatars.unpickle import load_pickle
from splatmorph.errors import ReadError

VERTICES, FACES, JOINTS = 5023, 9976, 5
SHAPES, EXPRESSIONS = 300, 100

ROTATION_FEATURES = 9 * (JOINTS - 1)

OTHER_MODELS = {6890: "SMPL or SMPL-H", 10475: "SMPL-X", 778: "MANO", 20908: "STAR"}
"""Models of the same file layout, by their count of vertices."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FlameArrays:
    """A linear head model of V vertices and F faces; float64, metres."""

    template: Array
    """(V, 3) the mean head."""
    shapes: Array
    """(V, 3, S) displacement of each vertex a unit of each shape coefficient."""
    expressions: Array
    """(V, 3, E) the same for expression coefficients."""
    poses: Array
    """(V, 3, 36) the same for the entries, less the identity's, of the four joint rotations."""
    regressor: Array
    """(5, V) joints from vertices: root, neck, jaw, two eyes."""
    parents: tuple[int, ...]
    """Parent of each joint; -1 for the root."""
    weights: Array
    """(V, 5) how much each vertex follows each joint; rows sum to 1."""
    faces: NDArray[np.int64]
    """(F, 3) vertex indices."""


def read_flame(path: Path) -> FlameArrays:
    """Read ``flame2023.pkl`` or ``generic_model.pkl``, with numpy or chumpy arrays inside.

    Raises:
        ReadError: missing, refused or damaged (see ``load_pickle``), or another model than FLAME.
    """
    stored = load_pickle(path)
    if not isinstance(stored, Mapping):
        raise ReadError(
            f"{path} holds a {type(stored).__name__}, expected FLAME's dictionary: give the "
            "model file (flame2023.pkl), not its masks or textures"
        )
    _require_flame(path, stored)
    template = _floats(path, stored, "v_template", (VERTICES, 3))
    poses = _floats(path, stored, "posedirs", (VERTICES, 3, ROTATION_FEATURES))
    regressor = _floats(path, stored, "J_regressor", (JOINTS, VERTICES))
    parents = _parents(path, _array(path, stored, "kintree_table"))
    weights = _floats(path, stored, "weights", (VERTICES, JOINTS))
    faces = _faces(path, _array(path, stored, "f"))
    blends = _floats(path, stored, "shapedirs", (VERTICES, 3, SHAPES + EXPRESSIONS))
    shapes, expressions = blends[:, :, :SHAPES], blends[:, :, SHAPES:]
    return FlameArrays(template, shapes, expressions, poses, regressor, parents, weights, faces)


def _require_flame(path: Path, stored: Mapping[Any, Any]) -> None:
    found = {key: _array(path, stored, key).shape for key in ("v_template", "kintree_table")}
    vertices, joints = found["v_template"][0], found["kintree_table"][-1]
    if (vertices, joints) != (VERTICES, JOINTS):
        other = OTHER_MODELS.get(vertices)
        raise ReadError(
            f"{path} is a model of {vertices} vertices and {joints} joints"
            f"{f' ({other})' if other else ''}, expected FLAME with {VERTICES} and {JOINTS}: "
            "give flame2023.pkl or generic_model.pkl"
        )


def _array(path: Path, stored: Mapping[Any, Any], key: str) -> NDArray[Any]:
    if key not in stored:
        names = ", ".join(sorted(str(name) for name in stored)[:6]) or "nothing"
        raise ReadError(
            f"{path} has no '{key}' (it has {names}), expected a FLAME model: give flame2023.pkl "
            "or generic_model.pkl"
        )
    try:
        array = as_array(stored[key])
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise ReadError(
            f"{path} has a '{key}' that is no array ({error}): download FLAME again"
        ) from error
    if array.ndim < 2 or array.dtype.kind not in "iuf":
        raise ReadError(f"{path} has a '{key}' that is no table of numbers: download FLAME again")
    return array


def _floats(path: Path, stored: Mapping[Any, Any], key: str, shape: tuple[int, ...]) -> Array:
    array = _array(path, stored, key)
    if array.shape != shape:
        raise ReadError(
            f"{path} has '{key}' of shape {array.shape}, expected {shape}: give the full model, "
            "flame2023.pkl or generic_model.pkl"
        )
    # A sum is finite only if every term is, and costs no mask.
    if not np.isfinite(array.sum(dtype=np.float64)):
        raise ReadError(f"{path} has NaN or infinite values in '{key}': download FLAME again")
    # A copy, since the array may lie in the file's bytes, which can't be written to.
    return np.array(array, np.float64, order="C")


def _parents(path: Path, table: NDArray[Any]) -> tuple[int, ...]:
    parents = (-1, *(int(parent) for parent in table[0, 1:]))
    if any(not 0 <= parent < joint for joint, parent in enumerate(parents) if joint):
        raise ReadError(
            f"{path} has joints that come before their parents ({parents}), expected FLAME's tree"
        )
    return parents


def _faces(path: Path, faces: NDArray[Any]) -> NDArray[np.int64]:
    if faces.shape != (FACES, 3) or faces.min() < 0 or faces.max() >= VERTICES:
        raise ReadError(
            f"{path} has faces of shape {faces.shape} up to vertex {faces.max()}, expected "
            f"({FACES}, 3) below {VERTICES}: download FLAME again"
        )
    return faces.astype(np.int64)
