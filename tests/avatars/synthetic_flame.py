"""A head model in FLAME's own form, made here: same keys, dtypes, counts and file layouts.

An ellipsoid of 5023 points with 9976 faces, a mouth where the teeth are hung, smooth random
shapes, and joints that turn what lies near them.
"""

from __future__ import annotations

import pickle  # noqa: TID251 - to write what the restricted reader reads
import struct
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement
from scipy.spatial import ConvexHull

from splatmorph.avatars.teeth import LOWER_LIP, UPPER_LIP

VERTICES, FACES = 5023, 9976
JOINT_PLACES = np.array(
    [[0, -0.12, 0], [0, -0.08, -0.02], [0, -0.01, 0.0], [0.03, 0.04, 0.06], [-0.03, 0.04, 0.06]]
)


@cache
def model() -> dict[str, NDArray[Any]]:
    """The arrays of the model under FLAME's keys; the regressor dense."""
    random = np.random.default_rng(5023)
    vertices = _with_mouth(_ellipsoid())
    hull = ConvexHull(vertices)
    faces = hull.simplices
    outward = np.einsum("fc,fc->f", hull.equations[:, :3], _normals(vertices, faces)) > 0
    faces = np.where(outward[:, None], faces, faces[:, ::-1])
    faces = np.delete(faces, _apart(faces, vertices, len(faces) - FACES), axis=0)
    away = np.linalg.norm(vertices[:, None] - JOINT_PLACES, axis=2)
    weights = np.exp(-((away / 0.05) ** 2)) + 1e-4
    regressor = np.zeros((5, VERTICES))
    for joint in range(5):
        nearest = np.argsort(away[:, joint], kind="stable")[:30]
        regressor[joint, nearest] = random.dirichlet(np.ones(30))
    return {
        "v_template": vertices,
        "shapedirs": _smooth_fields(vertices, 400, 2e-3, random),
        "posedirs": _smooth_fields(vertices, 36, 1e-3, random),
        "J_regressor": regressor,
        "kintree_table": np.array([[2**32 - 1, 0, 1, 1, 1], [0, 1, 2, 3, 4]], np.int64),
        "weights": weights / weights.sum(1, keepdims=True),
        "f": faces.astype(np.uint32),
    }


def write_new(path: Path, **changes: Any) -> Path:
    """As the FLAME 2023 file: numpy arrays and a scipy matrix."""
    stored = model() | {"J_regressor": scipy.sparse.csc_matrix(model()["J_regressor"])} | changes
    stored = {key: value for key, value in stored.items() if value is not None}
    return write_plain(path, stored)


def write_plain(path: Path, value: object) -> Path:
    """Any value, pickled."""
    path.write_bytes(pickle.dumps(value, protocol=4))
    return path


def write_chumpy(path: Path) -> Path:
    """As the older files, which Python 2 wrote: chumpy arrays and the scipy matrix of its time."""
    arrays = model()
    matrix = scipy.sparse.csc_matrix(arrays["J_regressor"])
    sparse = {
        "_shape": b"(K\x05M" + struct.pack("<H", VERTICES) + b"t",
        "data": _python2_array(matrix.data),
        "indices": _python2_array(matrix.indices),
        "indptr": _python2_array(matrix.indptr),
        "format": b"U\x03csc",
    }
    chumpy = {"v_template", "shapedirs", "posedirs", "weights"}
    items = {
        key: _instance("chumpy.ch", "Ch", {"x": _python2_array(value), "_dirty_vars": EMPTY_SET})
        if key in chumpy
        else _python2_array(value)
        for key, value in arrays.items()
    }
    items["J_regressor"] = _instance("scipy.sparse.csc", "csc_matrix", sparse)
    path.write_bytes(b"\x80\x02" + _dictionary(items) + b".")
    return path


EMPTY_SET = b"c__builtin__\nset\n(]tR"


def _python2_array(array: NDArray[Any]) -> bytes:
    """The opcodes by which Python 2's numpy pickled an array."""
    kind = array.dtype.str[1:].encode()
    shape = b"(" + b"".join(b"J" + struct.pack("<i", n) for n in array.shape) + b"t"
    raw = np.ascontiguousarray(array).tobytes()
    return (
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(K\x00tU\x01btR"
        b"(K\x01" + shape + b"cnumpy\ndtype\n(U" + bytes([len(kind)]) + kind + b"K\x00K\x01tR"
        b"(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
        b"\x89T" + struct.pack("<I", len(raw)) + raw + b"tb"
    )


def _instance(module: str, name: str, state: dict[str, bytes]) -> bytes:
    kind = f"ccopy_reg\n_reconstructor\n(c{module}\n{name}\nc__builtin__\nobject\nNtR"
    return kind.encode() + _dictionary(state) + b"b"


def _dictionary(items: dict[str, bytes]) -> bytes:
    return (
        b"}(" + b"".join(b"U" + bytes([len(k)]) + k.encode() + v for k, v in items.items()) + b"u"
    )


def write_embedding(path: Path) -> Path:
    """The 70 points: the corners and centers of some faces, torch tensors among the values."""
    import torch

    random = np.random.default_rng(70)
    weights = random.dirichlet(np.ones(3), size=(1, 70))
    stored = {
        "full_lmk_faces_idx": random.integers(0, FACES, (1, 70)),
        "full_lmk_bary_coords": torch.from_numpy(weights),
    }
    np.save(path, np.array(stored, dtype=object), allow_pickle=True)
    return path


def parameters(frames: int, seed: int = 0, *, teeth: bool = True) -> dict[str, NDArray[Any]]:
    """The content of a ``flame_param.npz``: one person, moving."""
    random = np.random.default_rng(seed)
    vertices = VERTICES + 120 * teeth
    return {
        "shape": random.normal(size=300) * 0.3,
        "expr": random.normal(size=(frames, 100)) * 0.3,
        "rotation": random.normal(size=(frames, 3)) * 0.2,
        "neck_pose": random.normal(size=(frames, 3)) * 0.1,
        "jaw_pose": np.abs(random.normal(size=(frames, 3))) * [0.3, 0, 0],
        "eyes_pose": random.normal(size=(frames, 6)) * 0.1,
        "translation": random.normal(size=(frames, 3)) * 0.05,
        "static_offset": random.normal(size=(1, vertices, 3)) * 1e-4,
        "dynamic_offset": np.zeros((frames, vertices, 3), np.float32),
    }


def write_avatar(
    folder: Path, splats: int = 500, frames: int = 4, seed: int = 0, *, teeth: bool = True
) -> Path:
    """A model directory as GaussianAvatars leaves it; returns the directory."""
    inner = folder / "point_cloud" / "iteration_600000"
    inner.mkdir(parents=True)
    faces = FACES + 168 * teeth
    binding = np.random.default_rng(seed).integers(0, faces, splats)
    # With teeth, some splat is always bound to them.
    binding[0] = faces - 1
    write_local(inner / "point_cloud.ply", binding, seed)
    np.savez(inner / "flame_param.npz", **parameters(frames, seed, teeth=teeth))
    return folder


def write_local(path: Path, binding: NDArray[Any], seed: int = 0) -> Path:
    """A triangle-local splat file of SH degree 3 with the given binding_0."""
    random = np.random.default_rng(seed)
    count = len(binding)
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3))]
    names += [*(f"f_rest_{i}" for i in range(45)), "opacity", *(f"scale_{i}" for i in range(3))]
    names += [*(f"rot_{i}" for i in range(4)), "binding_0"]
    table = np.empty(count, [(name, "<f4") for name in names])
    for name in names:
        table[name] = random.normal(size=count) * 0.5
    for name in ("nx", "ny", "nz"):
        table[name] = 0
    table["binding_0"] = binding
    PlyData([PlyElement.describe(table, "vertex")], byte_order="<").write(path)
    return path


def _ellipsoid() -> NDArray[np.float64]:
    """Points of equal area (Fibonacci) on a head-sized ellipsoid, y up, facing +z."""
    i = np.arange(VERTICES) + 0.5
    height = 1 - 2 * i / VERTICES
    angle = np.pi * (1 + 5**0.5) * i
    radius = np.sqrt(1 - height**2)
    points = np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], axis=1)
    return points * [0.08, 0.12, 0.1]


def _with_mouth(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same points, renumbered so that the lips' vertices lie at a mouth."""
    across = np.linspace(0.025, -0.025, 15)
    order = np.arange(VERTICES)
    taken: set[int] = set()
    for ring, height in ((UPPER_LIP, -0.03), (LOWER_LIP, -0.042)):
        for vertex, x in zip(ring, across, strict=True):
            spot = np.array([x, height, 0.09])
            nearest = np.argsort(np.linalg.norm(vertices[order] - spot, axis=1))
            other = next(int(n) for n in nearest if int(n) not in taken)
            order[[vertex, other]] = order[[other, vertex]]
            taken.add(vertex)
    return vertices[order]


def _apart(faces: NDArray[Any], vertices: NDArray[np.float64], count: int) -> list[int]:
    """The lowest faces of which no two share a vertex, so that without them none is left out."""
    chosen: list[int] = []
    touched: set[int] = set()
    for face in np.argsort(vertices[faces].mean(1)[:, 1], kind="stable").tolist():
        if len(chosen) < count and touched.isdisjoint(faces[face].tolist()):
            chosen.append(face)
            touched.update(faces[face].tolist())
    return chosen


def _normals(vertices: NDArray[np.float64], faces: NDArray[Any]) -> NDArray[np.float64]:
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return np.cross(b - a, c - a)


def _smooth_fields(
    vertices: NDArray[np.float64], count: int, size: float, random: np.random.Generator
) -> NDArray[np.float64]:
    waves = random.normal(size=(3, count)) * 20
    directions = random.normal(size=(3, count))
    return size * np.sin(vertices @ waves)[:, None, :] * directions
