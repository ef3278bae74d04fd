"""The laws of ramps and eases."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from morph_cases import random_gaussians

from renderer import bounds_of, orbit, rasterize
from splatmorph import io
from splatmorph.gaussians import FAINTEST_DRAWN, Gaussians
from splatmorph.morph.ramps import EASES, RAMPS, Ease, Ramp, calibrated, scaled_logits

WEIGHTS = [*np.linspace(0, 1, 41)[1:-1].tolist()]

every_ramp = pytest.mark.parametrize("ramp", RAMPS.values(), ids=RAMPS.keys())
every_ease = pytest.mark.parametrize("ease", EASES.values(), ids=EASES.keys())


def splats_of(opacities: torch.Tensor) -> Gaussians:
    some = random_gaussians(len(opacities))
    return replace(
        some,
        means=some.means.double(),
        log_scales=some.log_scales.double(),
        opacity_logits=opacities.double().logit(),
    )


@settings(deadline=None)
@given(logit=st.floats(-20, 40), factor=st.floats(1e-6, 1))
def test_scaled_logits_scale_the_opacity(logit: float, factor: float) -> None:
    logits = torch.tensor([logit], dtype=torch.float64)
    scaled = scaled_logits(logits, torch.tensor(factor, dtype=torch.float64).log())
    torch.testing.assert_close(scaled.sigmoid(), factor * logits.sigmoid())


def test_scaled_logits_of_factor_one_keep_saturated_opacities() -> None:
    logits = torch.tensor([-30.0, -3.0, 0.0, 12.0, 20.0, 60.0])
    torch.testing.assert_close(scaled_logits(logits, torch.zeros(())), logits)


@every_ramp
def test_a_ramp_rises_without_a_pop_from_nothing_to_the_splat(ramp: Ramp) -> None:
    some = splats_of(torch.linspace(0.005, 0.999, 60))
    faded = [ramp(some, weight) for weight in WEIGHTS]
    opacities = torch.stack([0 * some.opacities, *(f.opacities for f in faded), some.opacities])
    steps = opacities.clamp_max(0.99).diff(dim=0)
    assert (steps > -1e-12).all()
    # A fade at constant speed takes 1/40 a frame.
    assert steps.max() < 6 / 40
    log_scales = torch.stack([*(f.log_scales for f in faded), some.log_scales])
    assert log_scales.diff(dim=0).abs().max() < 1 / 40


@every_ramp
def test_a_ramp_changes_nothing_else_and_copes_with_saturated_splats(ramp: Ramp) -> None:
    some = replace(random_gaussians(6), opacity_logits=torch.tensor([-90.0, -20, 0, 20, 90, 5]))
    faded = ramp(some, 0.5)
    assert faded.means is some.means
    assert faded.quats is some.quats
    assert faded.sh is some.sh
    assert faded.opacity_logits.isfinite().all()
    assert faded.log_scales.isfinite().all()
    assert (faded.opacity_logits <= some.opacity_logits).all()


@pytest.mark.parametrize("weight", [0.01, 0.125, 0.25, 0.5])
def test_two_calibrated_copies_let_through_what_the_splat_does(weight: float) -> None:
    some = splats_of(torch.linspace(0.02, 0.99, 98))
    squared = torch.linspace(0, 14, 2001, dtype=torch.float64)[:, None]

    def profile(gaussians: Gaussians) -> torch.Tensor:
        width = (gaussians.log_scales - some.log_scales)[:, 0].exp()
        drawn = gaussians.opacities * torch.exp(-0.5 * squared / width**2)
        return torch.where(drawn < FAINTEST_DRAWN, 0, drawn)

    alone = profile(some)
    both = 1 - (1 - profile(calibrated(some, weight))) * (1 - profile(calibrated(some, 1 - weight)))
    error = both - alone
    assert error.abs().max() < 0.1
    # In the mean over the picture nothing gets thinner or denser (linear: up to 25 % thinner).
    assert (error.mean(0).abs() < 0.015 * alone.mean(0)).all()


@pytest.mark.parametrize("name", ["james", "status", "p2-1"])
def test_a_real_head_morphed_into_itself_looks_like_itself(shared_data: Path, name: str) -> None:
    head = io.read(shared_data / "heads" / f"{name}.ply")
    bounds = bounds_of(head.means.numpy(), head.opacities.numpy(), head.scales.numpy())
    cameras = orbit(bounds, [0, 35], width=256, height=256)

    def pictures(gaussians: Gaussians) -> np.ndarray:
        g = gaussians
        arrays = (g.means, g.quats, g.scales, g.opacities, g.sh)
        views = [
            rasterize(*(a.numpy() for a in arrays), c.viewmat, c.K, 256, 256, background=(1, 1, 1))
            for c in cameras
        ]
        return np.stack([rgb for rgb, _, _ in views])

    alone = pictures(head)
    for weight in (0.125, 0.5):
        halves = (calibrated(head, 1 - weight), calibrated(head, weight))
        error = np.square(pictures(Gaussians.union(*halves)) - alone).mean(axis=(1, 2, 3))
        assert (-10 * np.log10(error) > 45).all()


@every_ease
def test_an_ease_rises_from_0_to_1_and_is_symmetric(ease: Ease) -> None:
    times = torch.linspace(0, 1, 101, dtype=torch.float64).tolist()
    eased = torch.tensor([ease(t) for t in times], dtype=torch.float64)
    assert eased[0] == 0
    assert eased[-1] == 1
    assert (eased.diff() > 0).all()
    torch.testing.assert_close(eased, 1 - eased.flip(0))
    assert ease(-0.3) == -0.3
    assert ease(1.7) == 1.7
