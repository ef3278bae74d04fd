"""Rotations: the group, and every way between quaternions, matrices and axis-angle vectors."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation
from torch import Tensor

from splatmorph.geometry.quaternions import (
    from_matrices,
    matrices_from_axis_angles,
    normalized,
    product,
    to_matrices,
)

IDENTITY = torch.tensor([1.0, 0, 0, 0], dtype=torch.float64)
close = torch.testing.assert_close


def quats(n: int = 200, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(n, 4, generator=generator, dtype=torch.float64)


def same_rotation(a: Tensor, b: Tensor) -> None:
    close((normalized(a) * normalized(b)).sum(-1).abs(), torch.ones(a.shape[:-1]).double())


def test_the_product_is_a_group() -> None:
    a, b, c = (quats(seed=seed) for seed in range(3))
    close(product(product(a, b), c), product(a, product(b, c)))
    close(product(a, IDENTITY.expand_as(a)), a)
    inverse = a * torch.tensor([1.0, -1, -1, -1])
    same_rotation(product(a, inverse), IDENTITY.expand_as(a))


def test_matrices_multiply_as_quaternions_do() -> None:
    a, b = quats(), quats(seed=1)
    close(to_matrices(product(a, b)), to_matrices(a) @ to_matrices(b))
    close(to_matrices(a).mT @ to_matrices(a), torch.eye(3).double().expand(200, 3, 3))
    close(torch.linalg.det(to_matrices(a)), torch.ones(200).double())


def test_there_and_back_in_any_shape_and_of_any_length() -> None:
    a = 5 * quats().reshape(4, 50, 4)
    same_rotation(from_matrices(to_matrices(a)), a)
    close(to_matrices(a)[1, 7], to_matrices(a[1, 7]))
    assert to_matrices(a.float()).dtype == torch.float32


@pytest.mark.parametrize("axis", range(3))
def test_a_half_turn_keeps_its_precision(axis: int) -> None:
    vectors = torch.zeros(3, 3, dtype=torch.float64)
    vectors[:, axis] = torch.pi - torch.tensor([0, 1e-9, 1e-5])
    turned = matrices_from_axis_angles(vectors)
    close(to_matrices(from_matrices(turned)), turned, rtol=0, atol=1e-14)


@settings(max_examples=20, deadline=None)
@given(angles=arrays(np.float64, (5, 3), elements=st.floats(-4, 4)))
def test_matrices_are_scipys(angles: np.ndarray) -> None:
    wanted = Rotation.from_rotvec(angles)
    found = matrices_from_axis_angles(torch.from_numpy(angles))
    np.testing.assert_allclose(found, wanted.as_matrix(), atol=1e-13)
    stored = torch.from_numpy(wanted.as_quat(scalar_first=True))
    np.testing.assert_allclose(to_matrices(stored), wanted.as_matrix(), atol=1e-13)
    same_rotation(from_matrices(found), stored)


def test_a_zero_quaternion_is_no_turn() -> None:
    close(normalized(torch.zeros(2, 4).double()), IDENTITY.expand(2, 4))
