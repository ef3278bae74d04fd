"""Shapes under a flow: the covariance is J Σ Jᵀ, and its axes move without a jump."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from morph_cases import AffineFlow, affine_flow, random_gaussians, union
from torch import Tensor

from splatmorph.gaussians import Gaussians
from splatmorph.geometry.quaternions import to_matrices
from splatmorph.morph.covariance import polar_rotation, stretched_axes
from splatmorph.morph.paths import KNOTS
from splatmorph.morph.transport import COVARIANCES

TIMES = [k / 100 for k in range(1, 101)]


def normal(*shape: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def square_roots(gaussians: Gaussians) -> Tensor:
    """R S with Σ = R S (R S)ᵀ, (n, 3, 3)."""
    rotations = to_matrices(gaussians.quats.double())
    return rotations * gaussians.scales.double()[:, None]


def covariances(gaussians: Gaussians) -> Tensor:
    roots = square_roots(gaussians)
    return roots @ roots.mT


def whitened_error(found: Tensor, expected: Tensor) -> Tensor:
    """Distance of E⁻¹ F Fᵀ E⁻ᵀ from the identity: relative in every direction, thin ones too."""
    ratio = torch.linalg.solve(expected, found)
    return (ratio @ ratio.mT - torch.eye(3, dtype=torch.float64)).flatten(1).norm(dim=1)


def test_the_pushed_covariance_is_j_sigma_jt_for_needles_and_pancakes() -> None:
    n = 2000
    quats, log_scales = normal(4, n), 4 * normal(3, n, seed=1)
    jacobians = torch.eye(3, dtype=torch.float64)[:, :, None] + 0.2 * normal(3, 3, n, seed=2)
    axes, pushed = stretched_axes(jacobians, quats, log_scales, quats)
    found = to_matrices(axes.T) * pushed.T.exp()[:, None]
    roots = to_matrices(quats.T) * log_scales.T.exp()[:, None]
    expected = jacobians.permute(2, 0, 1) @ roots
    regular = torch.linalg.det(jacobians.permute(2, 0, 1)).abs() > 0.05
    assert whitened_error(found, expected)[regular].max() < 1e-4
    largest = expected.flatten(1).norm(dim=1)[:, None, None] ** 2
    assert ((found @ found.mT - expected @ expected.mT) / largest).abs().max() < 1e-6


def test_extreme_scales_stay_finite() -> None:
    log_scales = torch.tensor([[-60.0, 0, 0], [-60, -60, 3], [80, 0, -80], [-30, -30, -30]]).T
    quats = normal(4, 4)
    shear = torch.tensor([[1, 2, 0], [0, 1, 0.5], [0, 0, 1]], dtype=torch.float64)
    axes, pushed = stretched_axes(
        shear[:, :, None].expand(3, 3, 4), quats, log_scales.double(), quats
    )
    assert pushed.isfinite().all()
    torch.testing.assert_close(axes.norm(dim=0), quats.norm(dim=0))


def test_polar_rotation_is_the_nearest_rotation() -> None:
    jacobians = torch.eye(3, dtype=torch.float64)[:, :, None] + 0.3 * normal(3, 3, 500)
    u, _, vh = torch.linalg.svd(jacobians.permute(2, 0, 1))
    upright = torch.linalg.det(jacobians.permute(2, 0, 1)) > 0.01
    found = polar_rotation(jacobians).permute(2, 0, 1)
    torch.testing.assert_close(found[upright], (u @ vh)[upright])


def test_polar_rotation_of_folds_and_flats_is_a_rotation() -> None:
    mirror = torch.diag(torch.tensor([1.0, 1, -1], dtype=torch.float64))
    flat = torch.diag(torch.tensor([1.0, 1, 0], dtype=torch.float64))
    cases = torch.stack([mirror, -torch.eye(3).double(), flat, torch.zeros(3, 3).double()], -1)
    found = polar_rotation(cases).permute(2, 0, 1)
    identity = torch.eye(3, dtype=torch.float64).expand(4, 3, 3)
    torch.testing.assert_close(found @ found.mT, identity)
    torch.testing.assert_close(torch.linalg.det(found), torch.ones(4, dtype=torch.float64))


def pushed_by_the_flow(t: float) -> list[tuple[Tensor, Tensor]]:
    """Square roots of covariance, found and expected, of both halves of a full morph at t."""
    source, target = random_gaussians(50, seed=1), random_gaussians(30, seed=2)
    flow = affine_flow()
    found = square_roots(union(source, target, flow, covariance="full", ramp="linear").at(t))
    expected = []
    for whole, time in ((source, t), (target, t - 1)):
        jacobian = flow.trajectory_jacobian(whole.means, [time])[1][0].double()
        expected.append(jacobian @ square_roots(whole))
    return [(found[:50], expected[0]), (found[50:], expected[1])]


@pytest.mark.parametrize("knot", range(1, KNOTS))
def test_full_pushes_both_halves_by_the_jacobian_of_the_flow(knot: int) -> None:
    for found, expected in pushed_by_the_flow(knot / KNOTS):
        assert whitened_error(found, expected).max() < 1e-3


@settings(deadline=None, max_examples=20)
@given(t=st.floats(0.01, 0.99))
def test_full_is_interpolated_closely_between_knots(t: float) -> None:
    for found, expected in pushed_by_the_flow(t):
        assert whitened_error(found, expected).median() < 2e-3
        assert whitened_error(found, expected).max() < 0.05


def test_rotate_turns_by_the_polar_rotation_and_keeps_scales() -> None:
    source = random_gaussians(50, degree=2)
    flow = affine_flow()
    turned = (
        union(source, source, flow, covariance="rotate", ramp="linear")
        .at(0.999999)
        .select(torch.arange(50))
    )
    jacobian = flow.trajectory_jacobian(source.means, [0.999999])[1][0].double()
    rotation = polar_rotation(jacobian.permute(1, 2, 0)).permute(2, 0, 1)
    assert torch.equal(turned.log_scales, source.log_scales)
    torch.testing.assert_close(turned.quats.norm(dim=1), source.quats.norm(dim=1))
    expected = rotation @ covariances(source) @ rotation.mT
    torch.testing.assert_close(covariances(turned), expected, atol=1e-6, rtol=1e-4)


def test_a_rigid_turn_is_the_same_in_rotate_and_full() -> None:
    source = random_gaussians(50, degree=3)
    spin = torch.tensor([[0.0, -1, 0.3], [1, 0, -0.2], [-0.3, 0.2, 0]])
    flow = AffineFlow(spin, torch.zeros(3))
    rotate, full = (
        union(source, source, flow, covariance=c, ramp="linear").at(0.7) for c in ("rotate", "full")
    )
    for name in ("means", "quats", "log_scales", "sh"):
        torch.testing.assert_close(getattr(rotate, name), getattr(full, name), atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("covariance", COVARIANCES)
@pytest.mark.parametrize("sign", [1, -1])
def test_axes_move_without_a_jump_even_through_several_turns(covariance: str, sign: int) -> None:
    source = random_gaussians(100, seed=5)
    swirl = torch.tensor([[0.3, -9, 1], [9, -0.2, 0], [0.5, 0, 0.2]])
    morph = union(
        source, source, AffineFlow(swirl, torch.zeros(3)), covariance=covariance, ramp="linear"
    )
    times = [0.0, *TIMES[:-1]] if sign > 0 else [1.0, *TIMES[-2::-1]]
    half = torch.arange(len(source)) + (0 if sign > 0 else len(source))
    frames = [morph.source, *(f.select(half) for f in list(morph.sequence(times))[1:])]
    quats = torch.stack([f.quats / f.quats.norm(dim=1, keepdim=True) for f in frames])
    log_scales = torch.stack([f.log_scales for f in frames])
    assert quats.diff(dim=0).norm(dim=-1).max() < 0.5
    assert log_scales.diff(dim=0).abs().max() < 0.1


def test_identity_moves_nothing() -> None:
    source = random_gaussians(100, degree=3)
    still = AffineFlow(torch.zeros(3, 3), torch.zeros(3))
    for covariance in COVARIANCES:
        moved = (
            union(source, source, still, covariance=covariance, ramp="linear")
            .at(0.5)
            .select(torch.arange(100))
        )
        for name in ("means", "quats", "log_scales", "sh"):
            torch.testing.assert_close(getattr(moved, name), getattr(source, name))


def test_equal_scales_are_not_turned_by_rounding() -> None:
    ball = random_gaussians(100)
    ball.log_scales.fill_(-4.0)
    spin = torch.tensor([[0.0, -1, 0.3], [1, 0, -0.2], [-0.3, 0.2, 0]])
    flow = AffineFlow(spin, torch.zeros(3))
    rotate, full = (
        union(ball, ball, flow, covariance=c, ramp="linear").at(0.5) for c in ("rotate", "full")
    )
    torch.testing.assert_close(rotate.quats, full.quats, atol=1e-4, rtol=1e-4)
    assert math.isclose(float(full.log_scales.min()), -4, abs_tol=1e-4)
