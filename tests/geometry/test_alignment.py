"""The similarity between two sets of points: exact, robust, symmetric, and refused for mirrors."""

from __future__ import annotations

import math

import pytest
import torch
from test_similarity import DEGREES, assert_same, rotation
from torch import Tensor

from splatmorph.errors import LandmarkError
from splatmorph.geometry.alignment import similarity_between
from splatmorph.geometry.similarity import Similarity

dims = pytest.mark.parametrize("dim", [2, 3])


def cloud(count: int, dim: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(count, dim, generator=generator, dtype=torch.float64)


@dims
@pytest.mark.parametrize("degrees", DEGREES)
@pytest.mark.parametrize("scale", [1e-6, 1, 1e6])
@pytest.mark.parametrize("count", [4, 40])
def test_finds_what_was_done(count: int, scale: float, degrees: float, dim: int) -> None:
    p = cloud(count, dim)
    done = Similarity(rotation(dim, degrees), scale, 10 * scale * torch.ones(dim))
    assert_same(similarity_between(p, done(p)), done)


@dims
def test_swapping_the_sets_gives_the_inverse(dim: int) -> None:
    p = cloud(30, dim)
    done = Similarity(rotation(dim, 130), 7.0, torch.ones(dim))
    q = done(p + 0.2 * cloud(30, dim, 1))
    assert_same(similarity_between(q, p), similarity_between(p, q).inverse())


@dims
def test_a_similarity_of_either_set_is_composed_with_what_lies_between(dim: int) -> None:
    p = cloud(30, dim)
    q = p + 0.2 * cloud(30, dim, 1)
    rest = similarity_between(p, q)
    for degrees in (3, 150, 180):
        done = Similarity(rotation(dim, degrees, 3), 1000.0, 1e4 * torch.ones(dim))
        assert_same(similarity_between(p, done(q)), done @ rest)
        assert_same(similarity_between(done(p), q), rest @ done.inverse())


@dims
@pytest.mark.parametrize("count", [9, 12, 68])
def test_a_few_misplaced_pairs_change_nothing(count: int, dim: int) -> None:
    for seed in range(10):
        p = cloud(count, dim, seed)
        done = Similarity(rotation(dim, 170, seed), 50.0, torch.ones(dim))
        q = done(p)
        wrong = max(1, count // 6)
        q[:wrong] = q[:wrong].roll(1, 0) + 100 * cloud(wrong, dim, seed + 1)
        assert_same(similarity_between(p, q), done, 1e-6)


@dims
def test_one_coordinate_a_thousand_times_too_large_changes_nothing(dim: int) -> None:
    p = cloud(20, dim)
    q = p.clone()
    q[3, 0] *= 1000
    assert_same(similarity_between(p, q), Similarity.identity(dim), 1e-9)


@dims
def test_deformed_sets_are_believed_whole(dim: int) -> None:
    p = cloud(50, dim)
    q = p * 1.3 + 0.1 * torch.sin(3 * p)
    found = similarity_between(p, q)
    ratio = (q - q.mean(0)).norm() / (p - p.mean(0)).norm()
    assert found.scale == pytest.approx(float(ratio), rel=1e-12)


@pytest.mark.parametrize("degrees", DEGREES)
def test_points_on_a_line_are_turned_no_more_than_needed(degrees: float) -> None:
    along = torch.tensor([1.0, 2.0, -1.0], dtype=torch.float64)
    p = torch.tensor([0.0, 1.0, 2.5, 4.0], dtype=torch.float64)[:, None] * along
    turn = rotation(3, degrees, 4)
    found = similarity_between(p, p @ turn.T)
    torch.testing.assert_close(found(p), p @ turn.T)
    cosine = float(along @ (turn @ along)) / float(along @ along)
    # acos is blind near its ends.
    assert found.degrees == pytest.approx(math.degrees(math.acos(min(1, cosine))), abs=1e-5)


def test_points_of_a_plane_are_found_in_space() -> None:
    p = cloud(10, 3)
    p[:, 2] = 0
    done = Similarity(rotation(3, 100), 2.0, torch.ones(3))
    assert_same(similarity_between(p, done(p)), done)


@dims
@pytest.mark.parametrize("degrees", [0, 90, 180])
def test_mirror_images_are_refused_by_name(degrees: float, dim: int) -> None:
    p = cloud(30, dim)
    q = p + 0.05 * cloud(30, dim, 1)
    q[:, 1] *= -1
    q = Similarity(rotation(dim, degrees), 3.0, torch.ones(dim))(q)
    with pytest.raises(LandmarkError, match="mirror image"):
        similarity_between(p, q)


@dims
def test_sets_that_differ_wholly_are_no_mirror_images(dim: int) -> None:
    for seed in range(20):
        similarity_between(cloud(12, dim, seed), cloud(12, dim, seed + 100))


@dims
def test_one_point_has_no_similarity(dim: int) -> None:
    with pytest.raises(LandmarkError, match="target lie in one point"):
        similarity_between(cloud(5, dim), torch.ones(5, dim))
    with pytest.raises(LandmarkError, match="source lie in one point"):
        similarity_between(torch.ones(5, dim), cloud(5, dim))
