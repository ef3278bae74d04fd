"""Pictures of a row of splats are those of each splat."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from splats import random_gaussians

import splatmorph.rendering as rendering
from splatmorph.flows import make_flow
from splatmorph.gaussians import Gaussians
from splatmorph.morph import Morph
from splatmorph.rendering import bounds, pictures, render, turntable

A, B = random_gaussians(60, seed=1), random_gaussians(80, seed=2)
TIMES = [0.0, 0.3, 0.3, 0.3, 0.7, 1.0]


@pytest.fixture
def morph() -> Morph:
    flow = make_flow("node")
    flow.initialise(torch.Generator().manual_seed(0))
    return Morph(A, B, flow, blend="union")


def test_pictures_made_ahead_are_those_made_in_turn(morph: Morph) -> None:
    cameras = turntable(bounds(A, B), len(TIMES), size=(48, 32))
    made = list(pictures(morph.sequence(TIMES), cameras))
    assert len(made) == len(TIMES)
    for picture, t, camera in zip(made, TIMES, cameras, strict=True):
        assert np.array_equal(picture, render(morph.at(t), camera))


def test_a_splat_that_stands_still_is_prepared_once(
    morph: Morph, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared: list[Gaussians] = []

    def counted(splat: Gaussians) -> rendering.Arrays:
        prepared.append(splat)
        return arrays(splat)

    arrays = rendering.renderer_arrays
    monkeypatch.setattr(rendering, "renderer_arrays", counted)
    cameras = turntable(bounds(A, B), len(TIMES), size=(48, 32))
    assert len(list(pictures(morph.sequence(TIMES), cameras))) == len(TIMES)
    assert len(prepared) == len(set(TIMES))
    frames = list(morph.sequence(TIMES))
    assert frames[1] is frames[2] is frames[3]


def test_no_more_than_two_frames_are_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    pair = [random_gaussians(2100, seed=seed) for seed in (1, 2)]
    flow = make_flow("node")
    flow.initialise(torch.Generator().manual_seed(0))
    times = [i / 20 for i in range(1, 20)]
    places: set[int] = set()

    def noted(splat: Gaussians) -> rendering.Arrays:
        places.add(splat.sh.data_ptr())
        return arrays(splat)

    arrays = rendering.renderer_arrays
    monkeypatch.setattr(rendering, "renderer_arrays", noted)
    cameras = turntable(bounds(*pair), len(times), size=(16, 16))
    for _ in pictures(Morph(*pair, flow, blend="union").sequence(times), cameras):
        pass
    assert len(places) <= 2


def test_fewer_splats_than_cameras_are_a_mistake() -> None:
    cameras = turntable(bounds(A), 2, size=(48, 32))
    with pytest.raises(ValueError, match="not enough"):
        list(pictures([A], cameras))
