"""Which way up a splat stands, and how a target stands beside its source, in words."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from splatmorph import io
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.similarity import Similarity
from splatmorph.io.axes import turn_between
from splatmorph.registration.face_network import load_network
from splatmorph.runs.standing import standing
from splatmorph.runs.upright import standing_way

MakeGaussians = Callable[..., Gaussians]


@pytest.mark.parametrize("up", ["y", "-y"])
def test_things_stand_on_their_wider_end(make_gaussians: MakeGaussians, up: str) -> None:
    splats = make_gaussians(2000, 0)
    height = torch.linspace(0, 3, 2000)
    angle = 2.4 * torch.arange(2000)
    radius = 1.1 - 0.33 * height
    cone = torch.stack([radius * angle.cos(), height, radius * angle.sin()], 1)
    stood = replace(splats, means=cone.float()).moved(turn_between("y", up))
    assert standing_way(stood)[0] == up
    assert standing_way(replace(stood, up="z")) == ("z", "its file says so")


@pytest.mark.parametrize("up", ["y", "-y", "z"])
def test_a_face_says_which_way_is_up(shared_data: Path, up: str) -> None:
    pytest.importorskip("cv2")
    network = load_network(shared_data / "models" / "face_landmarker.task")
    head = io.read(shared_data / "heads" / "james.ply").moved(turn_between("y", up))
    axis, why = standing_way(replace(head, up=None), network)
    assert axis == up
    assert "face" in why


@pytest.mark.parametrize(
    ("factor", "units"), [(10, "mm against cm?"), (100, "cm against m?"), (1000, "mm against m?")]
)
def test_units_are_named_in_either_direction(factor: float, units: str) -> None:
    points = torch.rand(20, 3, dtype=torch.float64)
    for scale, larger, smaller in ((factor, "target", "source"), (1 / factor, "source", "target")):
        said = standing(Similarity(torch.eye(3), 1.07 * scale, torch.zeros(3)), points)
        assert said is not None
        assert said.endswith(f"the {larger} is about {factor} times the {smaller} ({units})")


def test_what_stands_together_needs_no_word() -> None:
    points = torch.rand(20, 3, dtype=torch.float64)
    assert standing(Similarity.identity(), points) is None
    turn = Similarity(
        turn_between("y", "-z").rotation, 1.0, torch.tensor([0, 0, math.tau], dtype=torch.float64)
    )
    assert "turned" in (standing(turn, points) or "")
