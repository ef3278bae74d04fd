"""Rotations of space: quaternions wxyz, matrices, axis-angle vectors, and the ways between."""

from __future__ import annotations

import torch
from torch import Tensor


def normalized(quats: Tensor) -> Tensor:
    """(..., 4) at unit length; a zero quaternion becomes the identity."""
    length = torch.linalg.vector_norm(quats, dim=-1, keepdim=True)
    identity = quats.new_tensor([1.0, 0.0, 0.0, 0.0])
    return torch.where(length > 0, quats / torch.where(length > 0, length, 1.0), identity)


def product(left: Tensor, right: Tensor) -> Tensor:
    """Hamilton product (..., 4): the rotation ``left`` after ``right``."""
    w, x, y, z = left.unbind(-1)
    a, b, c, d = right.unbind(-1)
    return torch.stack(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ],
        dim=-1,
    )


def to_matrices(quats: Tensor) -> Tensor:
    """Quaternions (..., 4) of any length but zero as rotation matrices (..., 3, 3)."""
    w, x, y, z = (quats / torch.linalg.vector_norm(quats, dim=-1, keepdim=True)).unbind(-1)
    # Each entry in one piece of memory, as those like it who go through matrices entry by entry.
    entries = torch.stack(
        [
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )
    return entries.movedim((0, 1), (-2, -1))


def matrices_from_axis_angles(axis_angles: Tensor) -> Tensor:
    """Rodrigues: vectors (..., 3), radians about their direction -> matrices (..., 3, 3)."""
    x, y, z = axis_angles.unbind(-1)
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1)
    return torch.linalg.matrix_exp(skew.unflatten(-1, (3, 3)))


def from_matrices(rotations: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) as quaternions (..., 4), to rounding for every angle.

    q qᵀ is linear in the matrix; its row with the largest diagonal is q up to a factor, free of
    cancellation (Shepperd's choice).
    """
    (a, b, c), (d, e, f), (g, h, i) = (row.unbind(-1) for row in rotations.unbind(-2))
    outer = torch.stack(
        [
            torch.stack([1 + a + e + i, h - f, c - g, d - b], dim=-1),
            torch.stack([h - f, 1 + a - e - i, b + d, c + g], dim=-1),
            torch.stack([c - g, b + d, 1 - a + e - i, f + h], dim=-1),
            torch.stack([d - b, c + g, f + h, 1 - a - e + i], dim=-1),
        ],
        dim=-2,
    )
    largest = outer.diagonal(dim1=-2, dim2=-1).argmax(-1)
    return normalized(outer.take_along_dim(largest[..., None, None], dim=-2).squeeze(-2))
