"""What every test may ask for."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

# The inputs of tests are small: a second thread waits longer than it works, the more so where
# other processes want the core. What is to be the same for one and more sets their number.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest
from splats import random_gaussians

from splatmorph.gaussians import Gaussians

REAL_INPUTS = os.environ.get("SPLATMORPH_TEST_DATA")


@pytest.fixture
def shared_data() -> Path:
    """The folder of real inputs, which are not part of the project; skips where absent."""
    if not REAL_INPUTS:
        pytest.skip("the real inputs are not here (set SPLATMORPH_TEST_DATA)")
    return Path(REAL_INPUTS)


@pytest.fixture(scope="session")
def make_gaussians() -> Callable[..., Gaussians]:
    """``make_gaussians(n, degree, seed)``: random splats."""
    return random_gaussians
