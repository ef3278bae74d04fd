"""Each format's picture is as near that of the ``.ply`` as docs/formats.md states."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from renderer import orbit
from splatmorph import io
from splatmorph.gaussians import Gaussians
from splatmorph.rendering import bounds, render

HEAD = Path(__file__).parents[2] / "assets" / "ines.ply"
STATED = {".compressed.ply": 53, ".spz": 49, ".sog": 60, ".splat": 31, ".glb": 90}
PLAIN = {".compressed.ply": 55, ".spz": 49, ".sog": 57, ".splat": 59, ".glb": 90}
"""Decibels, with and without harmonics."""


def decibels(a: Gaussians, b: Gaussians) -> float:
    """Peak signal to noise of pictures from three sides, the least."""
    cameras = orbit(bounds(a), [-30.0, 0.0, 60.0], width=256, height=256)
    pairs = ((render(a, camera), render(b, camera)) for camera in cameras)
    errors = [np.square(x.astype(float) - y.astype(float)).mean() for x, y in pairs]
    return 20 * math.log10(255) - 10 * math.log10(max(*errors, 1e-12))


@pytest.mark.parametrize("extension", STATED)
@pytest.mark.parametrize("degree", [0, 1])
def test_pictures_are_as_near_as_stated(tmp_path: Path, extension: str, degree: int) -> None:
    head = io.read(HEAD).with_sh_degree(degree)
    io.write(tmp_path / f"x{extension}", head)
    wanted = (STATED if degree else PLAIN)[extension]
    assert decibels(head, io.read(tmp_path / f"x{extension}")) >= wanted
