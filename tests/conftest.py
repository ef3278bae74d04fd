"""What every test may ask for."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from splats import random_gaussians

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


@pytest.fixture(scope="session")
def make_gaussians() -> Callable[..., Gaussians]:
    """``make_gaussians(n, degree, seed)``: random splats."""
    return random_gaussians
