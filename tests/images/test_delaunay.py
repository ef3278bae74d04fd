"""The piecewise-affine baseline."""

from __future__ import annotations

import pytest
import torch
from scenes import SQUARE, painted, some_landmarks

from splatmorph.errors import LandmarkError
from splatmorph.geometry.similarity import Similarity
from splatmorph.images import ImageMorph
from splatmorph.images.delaunay import DelaunayWarp
from splatmorph.landmarks import Landmarks


def test_landmarks_are_carried_to_landmarks() -> None:
    p, q = some_landmarks()
    warp = DelaunayWarp(p, q, SQUARE)
    for t in (0.0, 0.4, 1.0):
        assert torch.allclose(warp.carry(p.points, t), (1 - t) * p.points + t * q.points)


def test_what_stands_apart_is_played_as_a_whole() -> None:
    p, _ = some_landmarks()
    turn = torch.tensor([[0.0, -1.0], [1.0, 0.0]], dtype=torch.float64)
    frame = Similarity(turn, 2.0, torch.tensor([0.3, 0.1]))
    warp = DelaunayWarp(p, p.moved(frame), SQUARE, frame)
    for t in (0.0, 0.5, 1.0):
        assert torch.allclose(warp.carry(p.points, t), frame.power(t)(p.points))


def test_maps_undo_what_carry_does() -> None:
    warp = DelaunayWarp(*some_landmarks(), SQUARE)
    source, _ = next(warp.maps(SQUARE, [0.7]))
    where = source.band(0, SQUARE.height).reshape(-1, 2)
    back = warp.carry(where.double(), 0.7)
    centers = SQUARE.centers().reshape(-1, 2).double()
    # A pixel on an edge between triangles may take the map of its neighbour.
    assert float((back - centers).norm(dim=1).median()) < 1e-6
    assert float((back - centers).norm(dim=1).max()) < 1.5 * SQUARE.pixel


def test_ends_are_the_pictures() -> None:
    source, target = painted(64, 64), painted(64, 64, seed=1)
    morph = ImageMorph(source, target, DelaunayWarp(*some_landmarks(), SQUARE))
    assert (morph.at(0).eight_bit() == source.pixels).all()
    assert (morph.at(1).eight_bit() == target.pixels).all()


def test_landmarks_that_do_not_match_are_refused() -> None:
    p, q = some_landmarks(6)
    with pytest.raises(LandmarkError, match="6 source and 4 target"):
        next(DelaunayWarp(p, Landmarks(q.points[:4]), SQUARE).maps(SQUARE, [0.5]))
