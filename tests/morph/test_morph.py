"""The laws of the union blend."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from morph_cases import AffineFlow, affine_flow, random_gaussians, same_bits, union

from splatmorph.errors import NonFiniteError, OptionError
from splatmorph.gaussians import Gaussians
from splatmorph.morph.ramps import EASES, RAMPS
from splatmorph.morph.transport import COVARIANCES

SOURCE = random_gaussians(60, degree=1, seed=1)
TARGET = random_gaussians(40, degree=2, seed=2)

every_ramp = pytest.mark.parametrize("ramp", RAMPS)
every_covariance = pytest.mark.parametrize("covariance", COVARIANCES)
every_ease = pytest.mark.parametrize("ease", EASES)


def halves(morphed: Gaussians) -> tuple[Gaussians, Gaussians]:
    index = torch.arange(len(morphed))
    return morphed.select(index < len(SOURCE)), morphed.select(index >= len(SOURCE))


@every_ramp
@every_covariance
@every_ease
def test_ends_are_the_inputs_bit_for_bit(ramp: str, covariance: str, ease: str) -> None:
    morph = union(SOURCE, TARGET, affine_flow(), ramp=ramp, covariance=covariance, ease=ease)
    assert same_bits(morph.at(0), SOURCE)
    assert same_bits(morph.at(1.0), TARGET)
    first, middle, last = morph.sequence([0, 0.5, 1])
    assert same_bits(first, SOURCE)
    assert same_bits(last, TARGET)
    assert len(middle) == len(SOURCE) + len(TARGET)


@settings(deadline=None)
@given(t=st.floats(0.001, 0.999))
def test_linear_and_fixed_are_the_papers_union(t: float) -> None:
    flow = affine_flow()
    paper = union(SOURCE, TARGET, flow, ramp="linear", covariance="fixed")
    source, target = halves(paper.at(t))
    torch.testing.assert_close(source.means, flow.trajectory(SOURCE.means, [t])[0])
    torch.testing.assert_close(target.means, flow.trajectory(TARGET.means, [t - 1])[0])
    torch.testing.assert_close(source.opacities, (1 - t) * SOURCE.opacities)
    torch.testing.assert_close(target.opacities, t * TARGET.opacities)
    assert torch.equal(source.quats, SOURCE.quats)
    assert torch.equal(target.log_scales, TARGET.log_scales)
    assert torch.equal(source.sh[:, :4], SOURCE.sh)
    assert torch.equal(target.sh, TARGET.sh)


@every_covariance
def test_a_sequence_is_its_moments_and_costs_no_integration_a_frame(covariance: str) -> None:
    flow = affine_flow()
    morph = union(SOURCE, TARGET, flow, covariance=covariance, ease="smooth")
    times = [0.75, 0, 0.5, 1, 0.5, 0.2, -0.5, 1.5]
    frames = list(morph.sequence(times))
    # A half goes two ways, here both: it fades on the one, and is a caricature on the other.
    assert flow.calls == 4
    assert same_bits(frames[2], frames[4])
    for t, frame in zip(times, frames, strict=True):
        alone = morph.at(t)
        for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
            torch.testing.assert_close(getattr(frame, name), getattr(alone, name))


@every_ramp
@every_covariance
def test_swapping_the_inputs_reverses_the_morph(ramp: str, covariance: str) -> None:
    flow, back = affine_flow(), affine_flow()
    back.augmented.neg_()
    forth = union(SOURCE, TARGET, flow, ramp=ramp, covariance=covariance).at(0.3)
    reverse = union(TARGET, SOURCE, back, ramp=ramp, covariance=covariance).at(0.7)
    order = torch.arange(len(reverse)).roll(len(SOURCE))
    for name in ("means", "opacity_logits", "log_scales", "sh"):
        torch.testing.assert_close(getattr(forth, name), getattr(reverse.select(order), name))


def test_beyond_the_ends_one_input_travels_on() -> None:
    flow = affine_flow()
    morph = union(SOURCE, TARGET, flow)
    before, after = morph.sequence([-0.5, 1.25])
    torch.testing.assert_close(before.means, flow.trajectory(SOURCE.means, [-0.5])[0])
    torch.testing.assert_close(after.means, flow.trajectory(TARGET.means, [0.25])[0])
    assert torch.equal(before.opacity_logits, SOURCE.opacity_logits)
    assert torch.equal(after.opacity_logits, TARGET.opacity_logits)


@every_ramp
def test_stable_count_keeps_every_splat_in_its_place(ramp: str) -> None:
    morph = union(SOURCE, TARGET, affine_flow(), ramp=ramp, stable_count=True)
    times = [-1, 0, 0.5, 1, 2]
    frames = list(morph.sequence(times))
    assert {len(frame) for frame in frames} == {len(SOURCE) + len(TARGET)}
    assert all(frame.opacity_logits.isfinite().all() for frame in frames)
    source, unseen = halves(frames[1])
    assert torch.equal(source.means, SOURCE.means)
    assert torch.equal(source.opacity_logits, SOURCE.opacity_logits)
    assert unseen.opacities.max() < 1 / 255
    unseen, target = halves(frames[3])
    assert torch.equal(target.means, TARGET.means)
    assert torch.equal(target.opacity_logits, TARGET.opacity_logits)
    assert unseen.opacities.max() < 1 / 255


@pytest.mark.parametrize("t", [math.nan, math.inf, -math.inf])
def test_a_time_that_is_no_number_is_refused_at_once(t: float) -> None:
    with pytest.raises(OptionError, match="expected a finite number"):
        union(SOURCE, TARGET, affine_flow()).sequence([0, t])


@every_covariance
def test_splats_that_leave_for_infinity_stop_the_morph(covariance: str) -> None:
    growing = AffineFlow(200 * torch.eye(3), torch.zeros(3))
    morph = union(SOURCE, TARGET, growing, covariance=covariance)
    with pytest.raises(NonFiniteError, match="60 of 60 splats to infinity"):
        morph.at(0.9)


@pytest.mark.parametrize("option", ["ramp", "covariance", "ease"])
def test_an_unknown_name_lists_the_known_ones(option: str) -> None:
    with pytest.raises(OptionError, match=f"{option} 'cubic' is not one of: "):
        union(SOURCE, TARGET, affine_flow(), **{option: "cubic"})
