"""Frames: the same splat whatever its axes are called; what SPZ says of them."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from refusals import refused

from splatmorph import io
from splatmorph.gaussians import UPS, Gaussians
from splatmorph.geometry.harmonics import harmonics
from splatmorph.geometry.quaternions import to_matrices
from splatmorph.io.axes import DIRECTIONS, FRAMES, from_frame, turn_between, upright
from splatmorph.io.spz import FRAME_NAMES

MakeGaussians = Callable[..., Gaussians]


def into_usual(frame: str) -> torch.Tensor:
    return torch.tensor([DIRECTIONS[letter] for letter in frame]).double().T


def covariances(splats: Gaussians) -> torch.Tensor:
    half = to_matrices(splats.quats.double()) * splats.scales.double()[:, None]
    return half @ half.mT


def seen(splats: Gaussians, directions: torch.Tensor) -> torch.Tensor:
    bands = [harmonics(directions, band) for band in range(splats.sh_degree + 1)]
    return torch.einsum("dk,nkc->ndc", torch.cat(bands, -1), splats.sh.double())


# Laws ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("frame", FRAME_NAMES)
def test_turning_a_frame_moves_centers_shapes_and_colours_alike(
    make_gaussians: MakeGaussians, frame: str
) -> None:
    splats = make_gaussians(30, 3)
    found = from_frame(splats, frame)
    axes = into_usual(frame)
    if found.up != "y":
        assert FRAMES[found.up or ""] == frame
        assert torch.equal(found.means, splats.means)
        found = upright(found, "y")
    assert torch.allclose(found.means.double(), splats.means.double() @ axes.T, atol=1e-6)
    turned = axes @ covariances(splats) @ axes.T
    assert torch.allclose(covariances(found), turned, atol=1e-7)
    rays = torch.nn.functional.normalize(torch.randn(9, 3, dtype=torch.float64), dim=1)
    assert torch.allclose(seen(found, rays @ axes.T), seen(splats, rays), atol=1e-5)


@pytest.mark.parametrize("start", UPS)
@pytest.mark.parametrize("end", UPS)
def test_upright_is_a_group_action(make_gaussians: MakeGaussians, start: str, end: str) -> None:
    splats = replace(make_gaussians(20, 2), up=start, offset=(1.0, 2.0, 3.0))
    there = upright(splats, end)
    assert there.up == end
    where = torch.tensor(UPS[end], dtype=torch.float32)
    before = splats.absolute_means @ torch.tensor(UPS[start]).double()
    assert torch.allclose(there.absolute_means @ where.double(), before)
    back = upright(there, start)
    assert torch.allclose(back.means, splats.means, atol=1e-6)
    assert back.offset == splats.offset
    assert torch.allclose(back.sh, splats.sh, atol=1e-5)
    assert torch.equal(turn_between(start, end)(splats.absolute_means), there.absolute_means)


def test_half_turns_and_quarter_turns_round_no_center(make_gaussians: MakeGaussians) -> None:
    splats = make_gaussians(50, 0)
    for up in UPS:
        back = upright(upright(splats, up), "y")
        assert torch.equal(back.means, splats.means)


# SPZ ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("up", [None, *UPS])
def test_spz_says_which_axis_is_up(
    tmp_path: Path, make_gaussians: MakeGaussians, up: str | None
) -> None:
    splats = replace(make_gaussians(50, 1), up=up)
    io.write(tmp_path / "x.spz", splats)
    found = io.read(tmp_path / "x.spz")
    if up in (None, "y"):
        assert found.up is None
        assert "axes" not in io.layout(tmp_path / "x.spz")
    elif up in ("x", "-x"):
        # SPZ has no name for these.
        splats = upright(splats, "y")
    else:
        assert found.up == up
        assert f"axes {FRAMES[up]}" in io.layout(tmp_path / "x.spz")
    assert torch.allclose(found.means, splats.means, atol=1e-6)


@pytest.mark.parametrize("number", range(len(FRAME_NAMES) + 2))
def test_spz_in_any_frame_is_read(
    tmp_path: Path, make_gaussians: MakeGaussians, number: int
) -> None:
    splats = make_gaussians(50, 2)
    io.write(tmp_path / "plain.spz", splats)
    plain = io.read(tmp_path / "plain.spz")
    stored = bytearray(gzip.decompress((tmp_path / "plain.spz").read_bytes()))
    stored[14] |= 2
    other = struct.pack("<II3s", 0xADBE0002, 3, b"abc")
    stored += other + struct.pack("<III", 0xADBE0003, 4, number)
    (tmp_path / "x.spz").write_bytes(gzip.compress(bytes(stored)))
    if number > len(FRAME_NAMES):
        refused(tmp_path / "x.spz", "SPZ")
        return
    found = io.read(tmp_path / "x.spz")
    expected = from_frame(plain, FRAME_NAMES[number - 1]) if number else plain
    assert found.up == expected.up
    assert torch.equal(found.means, expected.means)
    assert torch.equal(found.sh, expected.sh)


def test_spz_of_version_1_has_halves(tmp_path: Path, make_gaussians: MakeGaussians) -> None:
    means = make_gaussians(7).means.numpy().astype("<f2")
    rest = [bytes([128]) * 7, bytes(range(21)), bytes([100]) * 21, bytes([127]) * 21]
    header = struct.pack("<4sIIBBBB", b"NGSP", 1, 7, 0, 0, 0, 0)
    whole = header + means.tobytes() + b"".join(rest)
    (tmp_path / "x.spz").write_bytes(gzip.compress(whole))
    found = io.read(tmp_path / "x.spz")
    assert np.array_equal(found.means, means.astype(np.float32))
    assert torch.allclose(found.log_scales, torch.tensor(100 / 16 - 10))
    assert "SPZ 1" in io.layout(tmp_path / "x.spz")
