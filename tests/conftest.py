"""What every test may ask for."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from splatmorph.gaussians import Gaussians

REAL_INPUTS = Path(
    os.environ.get("SPLATMORPH_TEST_DATA", Path(__file__).parents[2] / "shared" / "data")
)


@pytest.fixture
def shared_data() -> Path:
    """The folder of real inputs, which are not part of the project; skips where absent."""
    if not REAL_INPUTS.is_dir():
        pytest.skip("the real inputs are not here (set SPLATMORPH_TEST_DATA)")
    return REAL_INPUTS


def random_gaussians(n: int = 50, degree: int = 1, seed: int = 0) -> Gaussians:
    """n splats in a unit ball, small, of every opacity."""
    rng = torch.Generator().manual_seed(seed)
    return Gaussians(
        means=torch.rand(n, 3, generator=rng) * 2 - 1,
        quats=torch.randn(n, 4, generator=rng),
        log_scales=torch.randn(n, 3, generator=rng) * 0.5 - 3.5,
        opacity_logits=torch.randn(n, generator=rng) * 3,
        sh=torch.randn(n, (degree + 1) ** 2, 3, generator=rng) * 0.3,
    )


@pytest.fixture(scope="session")
def make_gaussians() -> Callable[..., Gaussians]:
    """``make_gaussians(n, degree, seed)``: random splats."""
    return random_gaussians
