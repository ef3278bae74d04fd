"""The teeth that GaussianAvatars adds to FLAME, which ends at the lips.

Two bars follow the lips' outer rings: 15 columns each, with a root and an edge, a front and a
back. Positions, order and corner order are those of the public GaussianAvatars model (Qian et al.
2024, flame_model/flame.py); they are part of its file format, since splats are bound to these
faces by number and lie in frames that begin at their first corners.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from splatmorph.avatars.flame_file import FACES, JOINTS, VERTICES, Array, FlameArrays

TEETH_VERTICES, TEETH_FACES = 120, 168
COLUMNS = 15
NECK, JAW = 1, 2

# FLAME vertices from the one corner of the mouth to the other, left first, one a column.
UPPER_LIP = [
    1713,
    1715,
    1716,
    1735,
    1696,
    1694,
    1657,
    3543,
    2774,
    2811,
    2813,
    2850,
    2833,
    2832,
    2830,
]
LOWER_LIP = [
    1576,
    1577,
    1773,
    1774,
    1795,
    1802,
    1865,
    3503,
    2948,
    2905,
    2898,
    2881,
    2880,
    2713,
    2712,
]

# Rows of 15 vertices in the order of the file: (joint, height, depth), where height and depth are
# in mean distances of the lips, from the line between the lips, up and forward.
ROWS = (
    (NECK, 2.1, -1.5),  # upper root
    (JAW, -2.1, -1.9),  # lower root
    (NECK, 0.1, -1.5),  # upper edge
    (JAW, -0.1, -1.9),  # lower edge
    (NECK, 2.1, -2.5),  # upper root, back
    (NECK, 0.1, -2.5),  # upper edge, back
    (JAW, -2.1, -2.9),  # lower root, back
    (JAW, -0.1, -2.9),  # lower edge, back
)

# The two triangles of a quad with corners 0, 1 on one row and 2, 3 on the other.
FALLING = ((0, 3, 2), (0, 1, 3))
RISING = ((0, 1, 2), (1, 3, 2))
FALLING_BACK = ((0, 2, 3), (0, 3, 1))
RISING_BACK = ((0, 2, 1), (1, 2, 3))

# Strips of 14 quads between two rows, with the split of their left and right halves.
STRIPS = (
    (0, 2, FALLING, RISING),
    (4, 5, FALLING_BACK, RISING_BACK),
    (5, 2, RISING_BACK, FALLING_BACK),
    (3, 1, RISING, FALLING),
    (6, 7, FALLING, RISING),
    (7, 3, RISING, FALLING),
)


def with_teeth(head: FlameArrays) -> FlameArrays:
    """The head with 120 vertices and 168 faces of teeth after its own.

    They take their shape from the lips, have no expression or pose correctives and no say in the
    joints; the upper ones follow the neck and the lower ones the jaw.
    """
    upper, lower = head.template[UPPER_LIP], head.template[LOWER_LIP]
    unit = np.linalg.norm(upper - lower, axis=1).mean()
    line = (upper + lower) / 2
    line[:, 1] = line[:, 1].mean()
    rows = [line + unit * np.array([0.0, height, depth]) for _, height, depth in ROWS]
    weights = np.zeros((TEETH_VERTICES, JOINTS))
    weights[np.arange(TEETH_VERTICES), np.repeat([joint for joint, _, _ in ROWS], COLUMNS)] = 1
    lips = (head.shapes[UPPER_LIP] + head.shapes[LOWER_LIP]) / 2
    return replace(
        head,
        template=np.concatenate([head.template, *rows]),
        shapes=np.concatenate([head.shapes, *[lips] * len(ROWS)]),
        expressions=_padded(head.expressions),
        poses=_padded(head.poses),
        regressor=_padded(head.regressor.T).T,
        weights=np.concatenate([head.weights, weights]),
        faces=np.concatenate([head.faces, teeth_faces()]),
    )


def teeth_faces() -> NDArray[np.int64]:
    """(168, 3) the faces of the teeth, by the numbers of their vertices in the whole head."""
    faces = []
    for first, second, left, right in STRIPS:
        for column in range(COLUMNS - 1):
            near, far = first * COLUMNS + column, second * COLUMNS + column
            corners = (near, near + 1, far, far + 1)
            split = left if column < (COLUMNS - 1) // 2 else right
            faces += [[corners[i] for i in triangle] for triangle in split]
    return np.array(faces, np.int64) + VERTICES


def has_teeth(vertices: int, faces: int) -> bool:
    """Whether a mesh of so many vertices and faces is FLAME with teeth."""
    return (vertices, faces) == (VERTICES + TEETH_VERTICES, FACES + TEETH_FACES)


def _padded(rows: Array) -> Array:
    return np.concatenate([rows, np.zeros((TEETH_VERTICES, *rows.shape[1:]))])
