"""Colours turn exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from splatmorph.geometry.harmonics import harmonics, rotate_sh

every_degree = pytest.mark.parametrize("degree", range(5))


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def directions(n: int, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.nn.functional.normalize(torch.randn(n, 3, generator=seeded(), dtype=dtype), dim=-1)


def rotations(n: int, dtype: torch.dtype = torch.float64) -> Tensor:
    orthogonal = torch.linalg.qr(torch.randn(n, 3, 3, generator=seeded(1), dtype=dtype))[0]
    return orthogonal * torch.linalg.det(orthogonal)[:, None, None]


def colours(sh: Tensor, seen: Tensor) -> Tensor:
    degree = math.isqrt(sh.shape[1]) - 1
    values = torch.cat([harmonics(seen, order) for order in range(degree + 1)], dim=-1)
    return torch.einsum("nk,nkc->nc", values, sh)


def test_the_first_bands_are_those_of_splat_files() -> None:
    seen = directions(20)
    x, y, z = seen.unbind(-1)
    first = math.sqrt(3 / (4 * math.pi)) * torch.stack([-y, z, -x], -1)
    a, b, c = 1.0925484305920792, 0.31539156525252005, 0.5462742152960396
    second = [a * x * y, -a * y * z, b * (2 * z * z - x * x - y * y), -a * x * z]
    second.append(c * (x * x - y * y))
    torch.testing.assert_close(harmonics(seen, 1), first)
    torch.testing.assert_close(harmonics(seen, 2), torch.stack(second, -1))
    torch.testing.assert_close(harmonics(seen, 3)[:, 1], 2.890611442640554 * x * y * z)
    torch.testing.assert_close(
        harmonics(seen, 3)[:, 6], -0.5900435899266435 * x * (x * x - 3 * y * y)
    )


@every_degree
def test_harmonics_are_orthonormal(degree: int) -> None:
    # Gauss-Legendre in z times equal angles integrates these polynomials exactly.
    nodes, weights = (torch.from_numpy(a) for a in np.polynomial.legendre.leggauss(8))
    angle = torch.arange(16, dtype=torch.float64) * math.tau / 16
    radius = (1 - nodes**2).sqrt()[:, None]
    grid = torch.stack(
        [radius * angle.cos(), radius * angle.sin(), nodes[:, None].expand(-1, 16)], -1
    )
    values = harmonics(grid, degree)
    gram = torch.einsum("zai,zaj,z->ij", values, values, weights * math.tau / 16)
    torch.testing.assert_close(gram, torch.eye(2 * degree + 1, dtype=torch.float64))


@every_degree
@pytest.mark.parametrize(("dtype", "bound"), [(torch.float64, 1e-12), (torch.float32, 1e-5)])
def test_rotating_then_evaluating_is_evaluating_turned_back(
    degree: int, dtype: torch.dtype, bound: float
) -> None:
    n = 500
    sh = 0.3 * torch.randn(n, (degree + 1) ** 2, 3, generator=seeded(2), dtype=dtype)
    turns, seen = rotations(n, dtype), directions(n, dtype)
    back = torch.einsum("nji,nj->ni", turns, seen)
    error = colours(rotate_sh(sh, turns), seen) - colours(sh, back)
    assert error.abs().max() < bound


def test_rotations_of_colours_are_a_group() -> None:
    sh = torch.randn(50, 16, 3, generator=seeded(3), dtype=torch.float64)
    first, second = rotations(100).chunk(2)
    identity = torch.eye(3, dtype=torch.float64).expand(50, 3, 3)
    torch.testing.assert_close(rotate_sh(sh, identity), sh)
    torch.testing.assert_close(rotate_sh(rotate_sh(sh, first), first.mT), sh)
    torch.testing.assert_close(
        rotate_sh(rotate_sh(sh, first), second), rotate_sh(sh, second @ first)
    )


def test_no_splats_and_no_view_dependence_need_no_rotation() -> None:
    assert rotate_sh(torch.zeros(0, 16, 3), torch.zeros(0, 3, 3)).shape == (0, 16, 3)
    flat = torch.randn(5, 1, 3)
    assert rotate_sh(flat, rotations(5)) is flat


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_one_rotation_for_all_is_the_same_for_each(degree: int) -> None:
    sh = torch.randn(9, (degree + 1) ** 2, 3, generator=torch.Generator().manual_seed(degree))
    turn = rotations(1)[0].to(sh)
    torch.testing.assert_close(
        rotate_sh(sh, turn), rotate_sh(sh, turn.expand(9, 3, 3)), atol=1e-5, rtol=1e-5
    )
