"""Frames that are made in memory that is used again, and the ramp that fades them there."""

from __future__ import annotations

import pytest
import torch
from morph_cases import AffineFlow, random_gaussians, same_bits

from renderer.cpp import FEWEST, plain_twins
from splatmorph.gaussians import Gaussians
from splatmorph.morph import Morph
from splatmorph.morph.memory import Memory
from splatmorph.morph.ramps import calibrated

TIMES = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]


def morph(degrees: tuple[int, int] = (1, 1), **options: object) -> Morph:
    flow = AffineFlow(0.2 * torch.tensor([[0.0, 1, 0], [-1, 0, 0], [0, 0.3, 0.1]]), torch.ones(3))
    source, target = (random_gaussians(70 + end, degree, end) for end, degree in enumerate(degrees))
    return Morph(source, target, flow, **{"blend": "union", **options})


def test_what_somebody_holds_is_not_written_to() -> None:
    kept, copies = [], []
    for frame in morph().sequence(TIMES):
        kept.append(frame)
        copies.append(frame.select(torch.arange(len(frame))))
    assert all(map(same_bits, kept, copies))
    assert len({frame.means.data_ptr() for frame in kept}) == len(TIMES)


def test_a_field_of_a_frame_keeps_all_of_it() -> None:
    frames = morph().sequence(TIMES[1:5])
    sh = next(frames).sh
    before = sh.clone()
    for _ in frames:
        pass
    assert torch.equal(sh, before)


def test_what_nobody_holds_is_used_again() -> None:
    memory = Memory()
    first = memory.splats(10, 2)
    places = {first.means.data_ptr()}
    second = memory.splats(10, 2)
    places.add(second.means.data_ptr())
    assert len(places) == 2
    assert memory.splats(11, 2).means.data_ptr() not in places
    del first, second
    assert {memory.splats(10, 2).means.data_ptr(), memory.splats(10, 2).means.data_ptr()} <= places


@pytest.mark.parametrize("degrees", [(0, 0), (0, 2), (3, 1)])
@pytest.mark.parametrize("covariance", ["fixed", "rotate", "full"])
@pytest.mark.parametrize("ramp", ["linear", "power", "calibrated"])
def test_a_frame_is_the_union_of_its_halves(degrees, covariance, ramp) -> None:
    """Source before target, whatever of it was made in place."""
    one = morph(degrees, covariance=covariance, ramp=ramp)
    for t, frame in zip(TIMES[1:5], one.sequence(TIMES[1:5]), strict=True):
        assert frame.sh_degree == max(degrees)
        assert len(frame) == 141
        assert list(frame.extras) == ["segment"]
        for half, part in enumerate((slice(0, 70), slice(70, None))):
            travelled = one.half(half, t).with_sh_degree(max(degrees))
            here = frame.select(part)
            torch.testing.assert_close(here.means, travelled.means)
            torch.testing.assert_close(here.quats, travelled.quats)
            torch.testing.assert_close(here.sh, travelled.sh, atol=1e-5, rtol=1e-5)
            assert (here.opacities <= travelled.opacities + 1e-6).all()


def test_what_wants_a_gradient_gets_it() -> None:
    one = morph()
    logits = one.source.opacity_logits.clone().requires_grad_()
    source = Gaussians(**{**vars(one.source), "opacity_logits": logits})
    frame = Morph(source, one.target, one.flow, blend="union").at(0.5)
    frame.opacities.sum().backward()
    assert logits.grad is not None
    assert logits.grad.isfinite().all()


@pytest.mark.parametrize("weight", [1e-6, 0.01, 0.3, 0.5, 0.99, 1 - 1e-6, "each"])
def test_native_fading_is_the_plain_one(weight) -> None:
    """From logits that round to no opacity to those that round to 1, also where they lie."""
    count = FEWEST + 13
    logits = torch.linspace(-30, 60, count)
    some = Gaussians(**{**vars(random_gaussians(count)), "opacity_logits": logits})
    if weight == "each":
        weight = torch.linspace(1e-6, 1 - 1e-6, count)
    native = calibrated(some, weight)
    with plain_twins():
        plain = calibrated(some, weight)
    torch.testing.assert_close(native.opacity_logits, plain.opacity_logits, atol=5e-5, rtol=1e-5)
    torch.testing.assert_close(native.log_scales, plain.log_scales, atol=2e-6, rtol=1e-6)
    room = random_gaussians(count, seed=1)
    there = calibrated(some, weight, room)
    assert there.opacity_logits.data_ptr() == room.opacity_logits.data_ptr()
    assert torch.equal(there.opacity_logits, native.opacity_logits)
    assert torch.equal(there.log_scales, native.log_scales)
