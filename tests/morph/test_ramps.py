"""The laws of ramps and eases."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatmorph.ramps import EASES, Ease, scaled_logits

every_ease = pytest.mark.parametrize("ease", EASES.values(), ids=EASES.keys())


@settings(deadline=None)
@given(logit=st.floats(-20, 40), factor=st.floats(1e-6, 1))
def test_scaled_logits_scale_the_opacity(logit: float, factor: float) -> None:
    logits = torch.tensor([logit], dtype=torch.float64)
    scaled = scaled_logits(logits, torch.tensor(factor, dtype=torch.float64).log())
    torch.testing.assert_close(scaled.sigmoid(), factor * logits.sigmoid())


def test_scaled_logits_of_factor_one_keep_saturated_opacities() -> None:
    logits = torch.tensor([-30.0, -3.0, 0.0, 12.0, 20.0, 60.0])
    torch.testing.assert_close(scaled_logits(logits, torch.zeros(())), logits)


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
