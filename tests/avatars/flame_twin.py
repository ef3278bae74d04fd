"""FLAME, triangle frames and landmarks once more: float64 NumPy, one vertex or splat at a time.

Written from the published equations and the description of the file format, without a look at
the package: slow and obvious.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def posed_vertices(model: dict[str, Any], shape: Array, expression: Array, pose: Array) -> Array:
    """(V, 3) vertices for shape (300,), expression (100,), axis-angle pose (5, 3)."""
    shaped = model["v_template"].copy()
    shaped += model["shapedirs"][:, :, :300] @ shape + model["shapedirs"][:, :, 300:] @ expression
    return skinned(model, shaped, pose)


def skinned(model: dict[str, Any], shaped: Array, pose: Array) -> Array:
    """(V, 3) a shaped mesh (offsets included) in a pose."""
    rotations = [Rotation.from_rotvec(vector).as_matrix() for vector in pose]
    feature = np.concatenate([(rotation - np.eye(3)).ravel() for rotation in rotations[1:]])
    corrected = shaped + model["posedirs"] @ feature
    joints = model["J_regressor"] @ shaped
    parents = [int(parent) for parent in model["kintree_table"][0]]
    world = [np.eye(4) for _ in parents]
    for joint in range(len(parents)):
        local = np.eye(4)
        local[:3, :3] = rotations[joint]
        local[:3, 3] = joints[joint] - (joints[parents[joint]] if joint else 0)
        world[joint] = world[parents[joint]] @ local if joint else local
    for joint in range(len(parents)):
        to_joint = np.eye(4)
        to_joint[:3, 3] = -joints[joint]
        world[joint] = world[joint] @ to_joint
    out = np.empty_like(corrected)
    for vertex, point in enumerate(corrected):
        blend = sum(w * matrix for w, matrix in zip(model["weights"][vertex], world, strict=True))
        out[vertex] = (blend @ np.append(point, 1))[:3]
    return out


def triangle_frame(v0: Array, v1: Array, v2: Array) -> tuple[Array, float, Array]:
    """R (3, 3), k and c of one triangle."""
    a0 = (v1 - v0) / np.linalg.norm(v1 - v0)
    normal = np.cross(a0, v2 - v0)
    a1 = normal / np.linalg.norm(normal)
    third = np.cross(a1, a0)
    a2 = -third / np.linalg.norm(third)
    k = (np.linalg.norm(v1 - v0) + abs(np.dot(a2, v2 - v0))) / 2
    return np.stack([a0, a1, a2], axis=1), float(k), (v0 + v1 + v2) / 3


def baked(
    mean: Array, quat: Array, log_scale: Array, corners: Array
) -> tuple[Array, Rotation, Array]:
    """World mean, rotation and standard deviations of one splat on one triangle (3, 3)."""
    rotation, k, center = triangle_frame(*corners)
    w, x, y, z = quat
    turn = Rotation.from_matrix(rotation) * Rotation.from_quat([x, y, z, w])
    return k * rotation @ mean + center, turn, k * np.exp(log_scale)


def on_faces(vertices: Array, faces: NDArray[Any], on: NDArray[Any], weights: Array) -> Array:
    """Barycentric points."""
    return np.array(
        [
            sum(w * vertices[v] for w, v in zip(row, faces[face], strict=True))
            for face, row in zip(on, weights, strict=True)
        ]
    )
