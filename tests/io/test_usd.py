"""USD: one file for one moment or for all of them, read back by usd-core moment by moment."""

from __future__ import annotations

import builtins
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from refusals import refused

from splatmorph import io
from splatmorph.errors import MissingExtraError, OptionError, WriteError
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.quaternions import to_matrices
from splatmorph.io.axes import upright
from splatmorph.io.packed import FAINTEST
from splatmorph.io.usd import HARMONICS, Timeline, read_usd, write_animation

pytest.importorskip("pxr", reason="usd-core is not installed")
from pxr import Usd, UsdGeom, UsdVol

MakeGaussians = Callable[..., Gaussians]


def rotations(splats: Gaussians) -> torch.Tensor:
    return to_matrices(splats.quats / splats.quats.norm(dim=1, keepdim=True))


def near(a: Gaussians, b: Gaussians) -> None:
    assert torch.equal(a.means, b.means)
    assert torch.allclose(a.log_scales, b.log_scales, atol=1e-5)
    assert torch.allclose(a.opacities, b.opacities, atol=2 * FAINTEST)
    assert torch.equal(a.sh, b.sh)
    assert torch.allclose(rotations(a), rotations(b), atol=1e-5)


def moving(first: Gaussians, count: int) -> list[Gaussians]:
    """Centers and opacities that change; shapes and colours that don't."""
    return [
        replace(first, means=first.means + 0.1 * i, opacity_logits=first.opacity_logits - i)
        for i in range(count)
    ]


@pytest.mark.parametrize("extension", [".usd", ".usda", ".usdc", ".usdz"])
@pytest.mark.parametrize("degree", [0, 2, 4])
def test_what_comes_back_is_rounded_to_floats(
    tmp_path: Path, make_gaussians: MakeGaussians, extension: str, degree: int
) -> None:
    splats = make_gaussians(40, degree)
    io.write(tmp_path / f"x{extension}", splats, ["half way"])
    back = io.read(tmp_path / f"x{extension}")
    assert back.up == "y"
    near(back, splats.with_sh_degree(min(degree, 3)))
    assert [path.name for path in tmp_path.iterdir()] == [f"x{extension}"]


def test_the_stage_says_what_the_schema_asks(tmp_path: Path, make_gaussians: MakeGaussians) -> None:
    splats = replace(make_gaussians(40, 1), up="z")
    io.write(tmp_path / "x.usda", splats)
    stage = Usd.Stage.Open(str(tmp_path / "x.usda"))
    prim = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert not stage.HasAuthoredTimeCodeRange()
    quats = splats.quats / splats.quats.norm(dim=1, keepdim=True)
    stored = prim.GetOrientationsAttr().Get()[7]
    assert np.allclose([stored.real, *stored.imaginary], quats[7], atol=1e-6)
    assert np.allclose(prim.GetScalesAttr().Get(), splats.scales, rtol=1e-5)
    assert np.allclose(prim.GetPrim().GetAttribute(HARMONICS).Get(), splats.sh.reshape(-1, 3))
    low, high = np.array(prim.GetExtentAttr().Get())
    assert (low < splats.means.numpy().min(0)).all()
    assert (high > splats.means.numpy().max(0)).all()


@pytest.mark.parametrize(("up", "held"), [("-y", "y"), ("x", "y"), ("z", "z"), (None, "y")])
def test_splats_stand_on_an_axis_that_usd_knows(
    tmp_path: Path, make_gaussians: MakeGaussians, up: str | None, held: str
) -> None:
    splats = replace(make_gaussians(30, 1), up=up)
    io.write(tmp_path / "x.usdc", splats)
    back = io.read(tmp_path / "x.usdc")
    assert back.up == held
    assert torch.equal(back.means, upright(splats, held).means)


def test_what_is_far_from_the_origin_keeps_its_detail(
    tmp_path: Path, make_gaussians: MakeGaussians
) -> None:
    splats = replace(make_gaussians(30, 0), offset=(500_000.0, 0.0, 4_100_000.0))
    io.write(tmp_path / "x.usdc", splats)
    assert torch.equal(io.read(tmp_path / "x.usdc").absolute_means, splats.absolute_means)


# Animations ---------------------------------------------------------------------------------


@pytest.mark.parametrize("extension", [".usda", ".usdc", ".usdz"])
def test_every_moment_is_in_the_one_file(
    tmp_path: Path, make_gaussians: MakeGaussians, extension: str
) -> None:
    frames = moving(make_gaussians(40, 1), 5)
    path = tmp_path / f"x{extension}"
    write_animation(path, frames, count=5, timeline=Timeline(2.0, 24.0, 0.001), degree=1)
    stage = Usd.Stage.Open(str(path))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 48)
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == 24
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.001
    for code, frame in zip((0, 12, 24, 36, 48), frames, strict=True):
        near(read_usd(path, time=code), frame)
    near(io.read(path), frames[0])
    # Between samples a player interpolates.
    half = read_usd(path, time=6)
    assert torch.allclose(half.means, (frames[0].means + frames[1].means) / 2, atol=1e-6)
    assert "an animation of 2 s" in io.layout(path)


def test_what_stands_still_is_stored_once(tmp_path: Path, make_gaussians: MakeGaussians) -> None:
    frames = moving(make_gaussians(40, 1), 5)
    write_animation(tmp_path / "x.usda", frames, count=5, degree=1)
    stage = Usd.Stage.Open(str(tmp_path / "x.usda"))
    prim = stage.GetDefaultPrim()
    moves = {name for name in prim.GetPropertyNames()
             if (found := prim.GetAttribute(name)) and found.GetNumTimeSamples()}  # fmt: skip
    assert moves == {"positions", "opacities", "extent"}


def test_what_begins_to_move_late_stood_still_before(
    tmp_path: Path, make_gaussians: MakeGaussians
) -> None:
    first = make_gaussians(40, 0)
    later = replace(first, log_scales=first.log_scales - 1)
    frames = [first, first, first, later]
    write_animation(tmp_path / "x.usdc", frames, count=4, timeline=Timeline(3.0, 1.0), degree=0)
    for time in (0.0, 0.7, 2.0):
        assert torch.allclose(
            read_usd(tmp_path / "x.usdc", time=time).log_scales, first.log_scales, atol=1e-5
        )
    assert torch.allclose(
        read_usd(tmp_path / "x.usdc", time=3).log_scales, later.log_scales, atol=1e-5
    )


def test_quaternions_take_the_short_way(tmp_path: Path, make_gaussians: MakeGaussians) -> None:
    first = make_gaussians(40, 0)
    frames = [first, replace(first, quats=-first.quats, means=first.means + 1)]
    write_animation(tmp_path / "x.usdc", frames, count=2, timeline=Timeline(1.0, 2.0), degree=0)
    between = read_usd(tmp_path / "x.usdc", time=1)
    assert torch.allclose(rotations(between), rotations(first), atol=1e-5)


def test_frames_may_differ_in_number(tmp_path: Path, make_gaussians: MakeGaussians) -> None:
    frames = [make_gaussians(20, 1), make_gaussians(50, 0), make_gaussians(30, 1)]
    write_animation(tmp_path / "x.usdc", frames, count=3, timeline=Timeline(2.0, 1.0), degree=1)
    for time, frame in enumerate(frames):
        near(read_usd(tmp_path / "x.usdc", time=time), frame.with_sh_degree(1))


# Bad input ----------------------------------------------------------------------------------


def test_a_failure_on_the_way_leaves_nothing(tmp_path: Path, make_gaussians: MakeGaussians) -> None:
    good = make_gaussians(20, 0)
    bad = replace(good, means=good.means * float("nan"))
    for extension in (".usdc", ".usdz"):
        with pytest.raises(WriteError, match="positions"):
            write_animation(tmp_path / f"x{extension}", [good, bad], count=2, degree=0)
    assert not list(tmp_path.iterdir())


def test_files_that_are_no_splats(tmp_path: Path, make_gaussians: MakeGaussians) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "mesh.usda"))
    UsdGeom.Sphere.Define(stage, "/ball")
    stage.Save()
    refused(tmp_path / "mesh.usda", "ParticleField3DGaussianSplat")
    io.write(tmp_path / "x.usdc", make_gaussians(200, 1))
    whole = (tmp_path / "x.usdc").read_bytes()
    for name, data in {"cut": whole[: len(whole) // 2], "noise": b"hello" * 99, "no": b""}.items():
        (tmp_path / f"{name}.usdc").write_bytes(data)
        refused(tmp_path / f"{name}.usdc")
    refused(tmp_path / "missing.usdc", "No such file")


@pytest.mark.parametrize("seed", range(3))
def test_damage_is_refused_whatever_usds_library_does(
    tmp_path: Path, make_gaussians: MakeGaussians, seed: int
) -> None:
    io.write(tmp_path / "x.usdc", make_gaussians(20, 1))
    damaged = bytearray((tmp_path / "x.usdc").read_bytes())
    # The tables at the end say how much is where.
    for i in np.random.default_rng(seed).integers(-700, -8, 30):
        damaged[i] ^= 0xFF
    (tmp_path / "x.usdc").write_bytes(damaged)
    refused(tmp_path / "x.usdc", "no whole USD file")


@pytest.mark.parametrize("attribute", ["scales", "opacities", HARMONICS])
def test_splats_that_lack_something(
    tmp_path: Path, make_gaussians: MakeGaussians, attribute: str
) -> None:
    io.write(tmp_path / "x.usda", make_gaussians(20, 0))
    stage = Usd.Stage.Open(str(tmp_path / "x.usda"))
    stage.GetDefaultPrim().RemoveProperty(attribute)
    stage.Save()
    refused(tmp_path / "x.usda", attribute)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_timelines_that_cannot_be(value: float) -> None:
    for name in ("seconds", "fps", "metres_per_unit"):
        with pytest.raises(OptionError, match=name):
            Timeline(**{name: value})


def test_without_usd_core_the_line_says_what_to_install(
    tmp_path: Path, make_gaussians: MakeGaussians, monkeypatch: pytest.MonkeyPatch
) -> None:
    genuine = builtins.__import__

    def without(name: str, *args: Any, **options: Any) -> Any:
        if name.partition(".")[0] == "pxr":
            raise ImportError(name)
        return genuine(name, *args, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtraError, match=r"splatmorph\[usd\]"):
        io.write(tmp_path / "x.usdc", make_gaussians(5))
