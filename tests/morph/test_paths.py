"""Paths at knots: exact there, close between, and no more of them held than are asked for."""

from __future__ import annotations

import pytest
import torch
from morph_cases import affine_flow, random_gaussians

from splatmorph.gaussians import Gaussians
from splatmorph.morph.paths import KNOTS, TURN, paths_of

SPLATS = random_gaussians(40, degree=1)


def centers(way: float, sign: int = 1) -> torch.Tensor:
    paths, weights = paths_of(SPLATS, affine_flow(), sign, [way], stretch=True).about(way)
    return paths["means"].at(weights)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("knot", [1, 3, KNOTS, KNOTS + 2])
def test_centers_are_the_flows_at_knots(knot: int, sign: int) -> None:
    way = knot / KNOTS
    expected = affine_flow().trajectory(SPLATS.means, [sign * way])[0]
    torch.testing.assert_close(centers(way, sign), expected)


@pytest.mark.parametrize("way", [1e-3, 0.05, 0.19, 0.6, 0.97])
def test_centers_are_close_to_the_flows_between_knots(way: float) -> None:
    expected = affine_flow().trajectory(SPLATS.means, [way])[0]
    size = float((affine_flow().trajectory(SPLATS.means, [1.0])[0] - SPLATS.means).abs().max())
    assert float((centers(way) - expected).abs().max()) < 1e-3 * size


def test_only_knots_about_the_ways_are_held_and_tell_the_same() -> None:
    whole = paths_of(SPLATS, affine_flow(), 1, [k / 20 for k in range(1, 20)], stretch=True)
    assert list(whole.kept) == list(range(1, KNOTS + 1))
    for way in (0.01, 0.3, 0.95):
        one = paths_of(SPLATS, affine_flow(), 1, [way], stretch=True)
        assert len(one.kept) <= 4
        for paths, weights in (one.about(way), whole.about(way)):
            assert paths["turns"].knots.dtype == torch.int16
            assert len(weights) == len(paths["means"].knots)
        for name, path in one.about(way)[0].items():
            torch.testing.assert_close(
                path.at(one.about(way)[1]),
                whole.about(way)[0][name].at(whole.about(way)[1]),
                atol=1.0 if name == "turns" else 1e-5,
                rtol=1e-5,
            )


def test_what_changes_is_what_has_a_path() -> None:
    plain = Gaussians(**{**vars(SPLATS), "sh": SPLATS.sh[:, :1]})
    held = paths_of(plain, affine_flow(), 1, [0.5], stretch=False).held
    assert held.keys() == {"means", "quats"}
    turns = paths_of(SPLATS, affine_flow(), 1, [0.5], stretch=True).held["turns"]
    assert (turns.knots.float().norm(dim=-1) / TURN - 1).abs().max() < 1e-4
