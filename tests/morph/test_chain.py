"""Chains and averages of several splats."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from morph_cases import affine_flow, random_gaussians, same_bits, union

from splatmorph.errors import LandmarkError, OptionError
from splatmorph.landmarks import Landmarks
from splatmorph.morph.chain import Chain, average, mean_landmarks
from splatmorph.morph.ramps import RAMPS
from splatmorph.runs.run import Run

A, B, C = (random_gaussians(n, degree=1, seed=n) for n in (20, 30, 25))


def abc(**options: object) -> Chain:
    return Chain([union(A, B, affine_flow(), **options), union(B, C, affine_flow(), **options)])


def test_whole_times_are_the_splats_bit_for_bit() -> None:
    for frame, splat in zip(abc(ramp="calibrated").sequence([0, 1, 2]), (A, B, C), strict=True):
        assert same_bits(frame, splat)


def test_a_chain_is_its_legs_in_any_order_of_times() -> None:
    chain = abc(covariance="full")
    times = [1.5, 0.25, 2.0, 1.0, -0.5, 2.25, 0.25]
    legs = [1, 0, 1, 1, 0, 1, 0]
    for t, leg, frame in zip(times, legs, chain.sequence(times), strict=True):
        alone = chain.morphs[leg].at(t - leg)
        torch.testing.assert_close(frame.means, alone.means)
        torch.testing.assert_close(frame.opacity_logits, alone.opacity_logits)
        assert same_bits(chain.at(t), alone)


def test_each_leg_is_integrated_once() -> None:
    flow = affine_flow()
    list(Chain([union(A, B, flow, covariance="fixed")]).sequence([0.1, 0.7, 0.3]))
    assert flow.calls == 2


def test_a_chain_refuses_what_it_cannot_do() -> None:
    with pytest.raises(ValueError, match="where one ended"):
        Chain([union(A, B, affine_flow()), union(C, A, affine_flow())])
    with pytest.raises(ValueError, match="at least one"):
        Chain([])
    with pytest.raises(OptionError, match="no stable count"):
        abc(stable_count=True)
    with pytest.raises(OptionError, match="finite number"):
        abc().sequence([math.nan])


@pytest.mark.parametrize("ramp", RAMPS)
def test_an_average_is_every_splat_at_the_common_shape_at_its_weight(ramp: str) -> None:
    flows = [affine_flow() for _ in range(3)]
    mean = average([A, B, C], flows, [1, 2, 1], ramp=ramp, blend="union")
    assert len(mean) == len(A) + len(B) + len(C)
    torch.testing.assert_close(mean.means[: len(A)], flows[0].trajectory(A.means, [1.0])[0])
    torch.testing.assert_close(mean.opacities[20:50], RAMPS[ramp](B, 0.5).opacities)


def test_an_average_of_two_is_the_middle_of_a_morph() -> None:
    forth, back = affine_flow(), affine_flow()
    forth.augmented.mul_(0.5)
    back.augmented.mul_(-0.5)
    middle = union(A, B, affine_flow(), covariance="full").at(0.5)
    mean = average([A, B], [forth, back], covariance="full", blend="union")
    torch.testing.assert_close(mean.means, middle.means)
    torch.testing.assert_close(mean.log_scales, middle.log_scales, atol=1e-3, rtol=1e-3)


def test_weight_only_on_one_leaves_it_whole_and_drops_the_others() -> None:
    only = average([A, B], [affine_flow()] * 2, [0, 3], ramp="calibrated")
    assert torch.equal(only.opacity_logits, B.opacity_logits)


@pytest.mark.parametrize("weights", [[0, 0], [1, -1], [math.nan, 1], [2, -1]])
def test_weights_must_be_proportions(weights: list[float]) -> None:
    with pytest.raises(OptionError, match="expected proportions"):
        average([A, B], [affine_flow()] * 2, weights)


def test_mean_landmarks_are_those_common_to_all_by_name() -> None:
    points = torch.arange(18.0).reshape(6, 3)
    first = Landmarks(points, tuple("abcdef"))
    second = Landmarks(points.flip(0) + 2, tuple("gedcba"))
    mean = mean_landmarks([first, second])
    assert mean.names == tuple("abcde")
    torch.testing.assert_close(mean.points[0], (points[0] + second.points[5]).double() / 2)
    with pytest.raises(LandmarkError, match="without names"):
        mean_landmarks([first, Landmarks(points)])
    with pytest.raises(LandmarkError, match="3 landmark names are common"):
        mean_landmarks([first, Landmarks(points[:4], tuple("abcz"))])


@pytest.mark.parametrize("option", [{"ease": "smooth"}, {"split": 2.0}])
def test_an_average_refuses_what_only_a_morph_has(option: dict[str, Any]) -> None:
    with pytest.raises(OptionError, match=f"has no t: leave out `{next(iter(option))}`"):
        Run((), (), {"mean": True}).average([], **option)
