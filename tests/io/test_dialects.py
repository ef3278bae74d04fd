"""Dialects of PLY: what each exporter means, from files that this module writes as they do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from plyfile import PlyData, PlyElement
from plys import stored_columns, write_columns
from refusals import refused

from splatmorph import io
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import SH0
from splatmorph.io.dialects import FLATNESS, STRANGE_FILES
from splatmorph.io.packed import FAINTEST

MakeGaussians = Callable[..., Gaussians]
Columns = dict[str, np.ndarray]


@pytest.fixture
def columns(tmp_path: Path, make_gaussians: MakeGaussians) -> Columns:
    io.write(tmp_path / "plain.ply", make_gaussians(40))
    return stored_columns(tmp_path / "plain.ply")


def read_back(folder: Path, columns: Columns) -> Gaussians:
    write_columns(folder / "dialect.ply", columns)
    return io.read(folder / "dialect.ply")


def test_inrias_own_layout_is_named_so(tmp_path: Path, columns: Columns) -> None:
    assert io.layout(tmp_path / "plain.ply") == "PLY as Inria lays it out"


# Colours as red, green, blue (nerfstudio) ---------------------------------------------------


@pytest.mark.parametrize(("kind", "most"), [("u1", 255), ("u2", 65535), ("f4", 1)])
def test_rgb_is_the_colour(tmp_path: Path, columns: Columns, kind: str, most: int) -> None:
    levels = np.linspace(0, most, 40).astype(kind)
    kept = {name: v for name, v in columns.items() if not name.startswith("f_")}
    rgb = {"red": levels, "green": levels[::-1].copy(), "blue": levels}
    splats = read_back(tmp_path, kept | rgb)
    assert splats.sh_degree == 0
    assert not splats.extras
    shown = 0.5 + SH0 * splats.sh[:, 0, 0].double().numpy()
    assert np.allclose(shown, levels / most, atol=1e-6)
    assert torch.equal(splats.sh[:, 0, 1], splats.sh[:, 0, 0].flip(0))
    assert "nerfstudio" in io.layout(tmp_path / "dialect.ply")


def test_rgb_beside_harmonics_is_an_extra(tmp_path: Path, columns: Columns) -> None:
    rgb = {name: np.zeros(40, "u1") for name in ("red", "green", "blue")}
    splats = read_back(tmp_path, columns | rgb)
    assert np.array_equal(splats.sh[:, 0, 0], columns["f_dc_0"])
    assert set(splats.extras) == set(rgb)


# Two scales (2DGS) --------------------------------------------------------------------------


def test_two_scales_make_a_flat_splat(tmp_path: Path, columns: Columns) -> None:
    del columns["scale_2"]
    scales = read_back(tmp_path, columns).scales
    assert np.allclose(scales[:, :2].log(), np.stack([columns["scale_0"], columns["scale_1"]], 1))
    assert torch.allclose(scales[:, 2], FLATNESS * scales[:, :2].amin(1), rtol=1e-5)
    assert "2D Gaussian Splatting" in io.layout(tmp_path / "dialect.ply")


# A 3D filter (Mip-Splatting) ----------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(width=st.floats(1e-4, 0.1), seed=st.integers(0, 99))
def test_the_filter_widens_every_splat_and_keeps_its_mass(
    tmp_path_factory: pytest.TempPathFactory,
    make_gaussians: MakeGaussians,
    width: float,
    seed: int,
) -> None:
    folder = tmp_path_factory.mktemp("mip")
    plain = make_gaussians(40, 0, seed)
    io.write(folder / "plain.ply", plain)
    filters = np.full(40, width, "f4")
    mip = read_back(folder, stored_columns(folder / "plain.ply") | {"filter_3D": filters})
    assert not mip.extras
    wider = (plain.scales.double() ** 2 + width**2).sqrt()
    assert torch.allclose(mip.scales.double(), wider, rtol=1e-5)
    # α Π s is the splat's mass up to a constant.
    mass = plain.opacities.double() * plain.scales.double().prod(1)
    assert torch.allclose(mip.opacities.double() * wider.prod(1), mass, rtol=1e-4)


def test_no_filter_changes_no_bit(tmp_path: Path, columns: Columns) -> None:
    plain = io.read(tmp_path / "plain.ply")
    mip = read_back(tmp_path, columns | {"filter_3D": np.zeros(40, "f4")})
    assert torch.equal(mip.log_scales, plain.log_scales)
    assert torch.equal(mip.opacity_logits, plain.opacity_logits)


def test_opacities_that_are_shrunk_already_stay(tmp_path: Path, columns: Columns) -> None:
    splats = read_back(tmp_path, columns | {"filter_3D": np.full(40, 0.9, "f4")})
    assert np.array_equal(splats.opacity_logits, columns["opacity"])
    assert (splats.scales > 0.9).all()


# Opacities of exactly 0 and 1 ---------------------------------------------------------------


def test_infinite_logits_are_opacities_of_0_and_1(tmp_path: Path, columns: Columns) -> None:
    columns["opacity"][3:5] = np.inf, -np.inf
    splats = read_back(tmp_path, columns)
    opacities = splats.opacities.double()
    assert float(opacities[3]) == pytest.approx(1 - FAINTEST, abs=1e-7)
    assert float(opacities[4]) == pytest.approx(FAINTEST, rel=1e-3)
    # And only those: finite ones keep their bits.
    assert np.array_equal(
        io.read(tmp_path / "dialect.ply").opacity_logits[5:], columns["opacity"][5:]
    )


# Headers ------------------------------------------------------------------------------------


@pytest.mark.parametrize("word", ["comment", "obj_info"])
@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("encoding", ["latin-1", "utf-8", "utf-16-le"])
def test_comments_come_in_any_language(
    tmp_path: Path, columns: Columns, word: str, text: bool, encoding: str
) -> None:
    write_columns(tmp_path / "x.ply", columns, text=text)
    whole = (tmp_path / "x.ply").read_bytes()
    start = whole.index(b"element")
    line = f"{word} ".encode() + "Köpfe, 1,7 m".encode(encoding) + b"\n"
    (tmp_path / "x.ply").write_bytes(whole[:start] + line + whole[start:])
    assert torch.equal(io.read(tmp_path / "x.ply").means, io.read(tmp_path / "plain.ply").means)


@pytest.mark.parametrize("first", [True, False])
def test_more_elements_are_passed_over(tmp_path: Path, columns: Columns, first: bool) -> None:
    vertex = PlyData.read(tmp_path / "plain.ply")["vertex"]
    # As Apple's SHARP and Niantic's tools add cameras and image sizes.
    camera = PlyElement.describe(np.zeros(9, [("intrinsic", "f4")]), "intrinsic")
    size = PlyElement.describe(np.array([(640,), (480,)], [("image_size", "u4")]), "image_size")
    elements = [camera, size, vertex] if first else [vertex, camera, size]
    PlyData(elements).write(tmp_path / "more.ply")
    assert torch.equal(io.read(tmp_path / "more.ply").sh, io.read(tmp_path / "plain.ply").sh)


# What is named, not read --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("f_anchor_feat_0", "f_offset_0"), ("Scaffold-GS", "explicit")),
        (("trbf_center", "motion_0"), ("many moments", "one moment")),
        (("scale_t", "rot_r_0"), ("many moments", "4D")),
    ],
)
def test_other_kinds_are_named_with_the_way_out(
    tmp_path: Path, columns: Columns, names: tuple[str, ...], words: tuple[str, ...]
) -> None:
    write_columns(tmp_path / "x.ply", columns | {name: np.zeros(40, "f4") for name in names})
    refused(tmp_path / "x.ply", names[0], *words)


@pytest.mark.parametrize("extension", STRANGE_FILES)
def test_files_of_other_kinds_are_named_by_their_extension(tmp_path: Path, extension: str) -> None:
    (tmp_path / f"x{extension}").write_bytes(b"whatever")
    refused(tmp_path / f"x{extension}", STRANGE_FILES[extension])


def test_the_still_splat_of_a_moving_one_is_read_and_named(
    tmp_path: Path, make_gaussians: MakeGaussians
) -> None:
    splats = make_gaussians(20)
    io.write(tmp_path / "point_cloud.ply", splats)
    (tmp_path / "deformation.pth").touch()
    assert "many moments" in io.layout(tmp_path / "point_cloud.ply")
    assert torch.equal(io.read(tmp_path / "point_cloud.ply").means, splats.means)
