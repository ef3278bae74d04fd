"""Areas that a warp turns over are found, and none where there are none."""

from __future__ import annotations

import pytest
import torch

from splatmorph.flows import make_flow
from splatmorph.geometry.similarity import Similarity
from splatmorph.images import Canvas, FlowWarp
from splatmorph.images.delaunay import DelaunayWarp
from splatmorph.images.folding import least_area
from splatmorph.landmarks import Landmarks


def test_what_nothing_moves_keeps_its_area() -> None:
    area = least_area(FlowWarp(make_flow("linear", dim=2)))
    assert area.least == pytest.approx(1, abs=1e-3)
    assert area.folded == 0


def test_a_similarity_multiplies_areas_by_the_square_of_its_scale() -> None:
    frame = Similarity(torch.eye(2, dtype=torch.float64), 2.0, torch.zeros(2, dtype=torch.float64))
    area = least_area(FlowWarp(make_flow("linear", dim=2), frame))
    assert area.least == pytest.approx(1 / 4, rel=1e-2)
    assert area.folded == 0


def test_triangles_that_are_turned_over_are_seen() -> None:
    p = torch.tensor([[-0.1, 0.0], [0.1, 0.0], [0.0, 0.5], [0.0, -0.5]], dtype=torch.float64)
    q = p.clone()
    q[0, 0] = 0.25  # past its neighbour
    area = least_area(DelaunayWarp(Landmarks(p), Landmarks(q), Canvas(64, 64)))
    assert area.least < 0
    assert 0 < area.folded < 0.5
