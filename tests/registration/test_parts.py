"""The parts of a registration, each by its law."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

import splatmorph as sm
from splatmorph.geometry.spreading import farthest
from splatmorph.registration.assignment import soft
from splatmorph.registration.cleaning import without_floaters
from splatmorph.registration.descriptors import blur
from splatmorph.registration.gaps import gap_between
from splatmorph.registration.pose import _Batch, rotations
from splatmorph.registration.regression import Pairs, Planes, flow, regress, still
from splatmorph.registration.surfaces import see_surface

ASSETS = Path(__file__).parents[2] / "assets"


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 999), scale=st.floats(0.1, 30))
def test_no_point_is_given_away_twice(seed: int, scale: float) -> None:
    costs = scale * torch.randn(20, 30, generator=torch.Generator().manual_seed(seed))
    plan = soft(costs)
    assert float(plan.min()) >= 0
    assert float(plan.sum(0).max()) <= 1 + 1e-5
    assert torch.equal(soft(costs), plan)


def test_the_blur_is_a_gaussian_one() -> None:
    picture = np.random.default_rng(0).normal(size=(40, 40)).astype(np.float32)
    found = blur(torch.from_numpy(picture)[None], 2.5)[0]
    np.testing.assert_allclose(found, gaussian_filter(picture, 2.5), atol=2e-3)


def test_rotations_fill_the_group() -> None:
    turns = rotations(96)
    torch.testing.assert_close(turns[0], torch.eye(3))
    torch.testing.assert_close(turns @ turns.mT, torch.eye(3).expand(96, 3, 3))
    rng = np.random.default_rng(1).normal(size=(500, 4))
    from splatmorph.geometry.quaternions import to_matrices

    others = to_matrices(torch.from_numpy(rng)).float()
    traces = torch.einsum("aij,bij->ab", others, turns).amax(1)
    assert float(traces.min()) > 1 + 2 * np.cos(np.radians(60))


def test_regression_meets_pairs_and_planes() -> None:
    rng = torch.Generator().manual_seed(0)
    p = torch.rand(200, 3, generator=rng) * 2 - 1
    q = p + 0.1 * torch.sin(2 * p.roll(1, 1))
    exact = regress(
        still(), Pairs(p, q, torch.full((200,), 1 / 200)), bending=1e-7, centers=200, corrections=6
    )
    assert float((flow(exact, p, 1.0) - q).norm(dim=1).max()) < 2e-3
    normals = torch.tensor([0.0, 0.0, 1.0]).expand(200, 3)
    shifted = p + torch.tensor([0.3, 0.0, 0.1])
    few = Pairs(p[:20], p[:20] + torch.tensor([0.0, 0.0, 0.1]), torch.full((20,), 1e-3))
    onto = Planes(p, shifted, torch.full((200,), 1 / 200), normals)
    bound = regress(still(), few, onto, bending=1e-6, centers=100, corrections=4)
    moved = flow(bound, p, 1.0) - p
    # Onto the planes, not along them.
    assert float((moved[:, 2] - 0.1).abs().max()) < 5e-3
    assert float(moved[:, :2].abs().max()) < 5e-3


def test_floaters_go_and_the_head_stays() -> None:
    head = sm.read(ASSETS / "otto.ply")
    assert len(without_floaters(head)) >= 0.999 * len(head)
    rng = torch.Generator().manual_seed(0)
    count = 500
    chosen = head.select(torch.randint(len(head), (count,), generator=rng))
    floaters = replace(chosen, means=(torch.rand(count, 3, generator=rng) - 0.5) * 1.2)
    cleaned = without_floaters(sm.Gaussians.union(head, floaters))
    assert len(cleaned) < len(head) + 0.25 * count
    assert len(cleaned) > 0.99 * len(head)


def test_the_surface_of_a_ball_is_round_and_faces_outwards() -> None:
    rng = torch.Generator().manual_seed(0)
    points = torch.randn(6000, 3, generator=rng)
    ball = sm.Gaussians(
        means=7.0 + 2 * points / points.norm(dim=1, keepdim=True),
        quats=torch.tensor([1.0, 0, 0, 0]).expand(6000, 4),
        log_scales=torch.full((6000, 3), -2.6),
        opacity_logits=torch.full((6000,), 4.0),
        sh=torch.zeros(6000, 1, 3),
    )
    surface, center, radius = see_surface(ball)
    np.testing.assert_allclose(center, 7.0, atol=0.02)
    assert abs(radius / 2 - 1) < 0.05
    from_center = surface.points - center
    outward = from_center / np.linalg.norm(from_center, axis=1, keepdims=True)
    assert np.quantile((outward * surface.normals).sum(1), 0.02) > 0.9
    chosen = farthest(surface.points, 50)
    assert len(set(chosen.tolist())) == 50


def test_the_gap_of_two_planes_is_their_distance() -> None:
    side = torch.linspace(-1, 1, 60)
    plane = torch.stack([*torch.meshgrid(side, side, indexing="xy"), torch.zeros(60, 60)], -1)
    a = plane.reshape(-1, 3)
    near = gap_between(a, a + torch.tensor([0.0, 0.0, 0.03]), 1.0)
    assert abs(near.mean - 0.03) < 1e-6
    assert near.alone == 0
    half = gap_between(a, a[a[:, 0] < 0], 1.0)
    assert 0.2 < half.alone < 0.25


def test_a_rotation_in_single_precision_is_a_pose() -> None:
    rounded = torch.eye(3)[None] + 2e-6 * torch.ones(1, 3, 3)
    batch = _Batch(rounded, torch.ones(1), torch.zeros(1, 3))
    torch.testing.assert_close(
        batch.similarity(0).rotation, torch.eye(3).double(), atol=1e-5, rtol=0
    )
