"""The lossy formats: what comes back lies within the bounds that docs/formats.md states."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from plyfile import PlyData, PlyElement
from refusals import refused

from splatmorph import io
from splatmorph.errors import WriteError
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import SH0

MakeGaussians = Callable[..., Gaussians]

LOSSY = (".compressed.ply", ".splat", ".spz")
WRITTEN_BY_OTHERS = Path(__file__).parent / "formats"
ALPHA = 0.5 / 255 + 1e-6
FLOAT = 1e-6


def round_trip(folder: Path, extension: str, splats: Gaussians) -> Gaussians:
    path = folder / f"x{extension}"
    io.write(path, splats, ["a comment"])
    back = io.read(path)
    assert len(back) == len(splats)
    return back


def degrees_apart(a: Gaussians, b: Gaussians) -> float:
    p, q = (x.quats.double() / x.quats.double().norm(dim=1, keepdim=True) for x in (a, b))
    chord = torch.minimum((p - q).norm(dim=1), (p + q).norm(dim=1))
    return float(torch.rad2deg(4 * torch.asin(chord / 2)).max())


def largest(difference: torch.Tensor) -> float:
    return float(difference.abs().max()) if difference.numel() else 0.0


def colours(splats: Gaussians) -> torch.Tensor:
    return 0.5 + SH0 * splats.sh[:, 0]


def known() -> Gaussians:
    """The splats of the files in ``formats/``, which other programs wrote."""
    steps = torch.arange(5.0)[:, None]
    return Gaussians(
        means=torch.cat([0.25 * steps - 0.5, 0.1 * steps**2, 0.3 - 0.05 * steps], 1),
        quats=torch.cat([2 + 0 * steps, 0.2 * steps, 0.5 - 0.3 * steps, 0.1 * steps - 0.4], 1),
        log_scales=torch.cat([-3 - 0.3 * steps, -4 + 0.2 * steps, -5 + 0 * steps], 1),
        opacity_logits=(1.5 * steps - 3)[:, 0],
        sh=torch.cat([0.2 * steps - 0.4, 0.05 * steps, 0.3 - 0.1 * steps, -0.1 * steps], 1)[
            :, :, None
        ]
        * torch.tensor([1.0, 0.5, -0.8]),
    )


# Laws ---------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(
    n=st.integers(1, 600),
    degree=st.integers(0, 4),
    seed=st.integers(0, 999),
    unit=st.sampled_from([1e-3, 1.0, 1e4]),
    length=st.sampled_from([1e-12, 1.0, 3e5]),
)
def test_what_comes_back_is_within_the_bounds(
    tmp_path_factory: pytest.TempPathFactory,
    make_gaussians: MakeGaussians,
    n: int,
    degree: int,
    seed: int,
    unit: float,
    length: float,
) -> None:
    splats = make_gaussians(n, degree, seed)
    splats = replace(
        splats,
        means=splats.means * unit,
        quats=splats.quats * length,
        # Within what every format can hold.
        sh=(0.3 * splats.sh).clamp(-0.99, 0.99),
    )
    folder = tmp_path_factory.mktemp("formats")
    back = {extension: round_trip(folder, extension, splats) for extension in LOSSY}
    for extension, most in {".compressed.ply": 0.3, ".splat": 1.2, ".spz": 0.3}.items():
        assert degrees_apart(back[extension], splats) <= most
        assert largest(back[extension].opacities - splats.opacities) <= ALPHA
        assert not back[extension].extras

    compressed, splat, spz = back.values()
    assert torch.equal(splat.means, splats.means)
    assert largest(spz.means - splats.means) <= max(2**-25, 2**-22 * largest(splats.means))
    assert largest(splat.log_scales - splats.log_scales) <= 1e-5
    assert largest(spz.log_scales - splats.log_scales) <= 1 / 32 + FLOAT
    for field, steps in {"means": (2047, 1023, 2047), "log_scales": (2047, 1023, 2047)}.items():
        stored, read = (getattr(x, field).double().split(256) for x in (splats, compressed))
        for one, other in zip(stored, read, strict=True):
            extent = one.amax(0) - one.amin(0)
            slack = FLOAT * one.abs().max()
            assert ((one - other).abs() <= extent / (2 * torch.tensor(steps)) + slack).all()

    assert splat.sh_degree == 0
    assert compressed.sh_degree == spz.sh_degree == min(degree, 3)
    for one in back.values():
        assert largest(colours(one) - colours(splats)) <= 0.5 / 255 * max(1, SH0 / 0.15) + FLOAT
    higher = splats.sh[:, 1:16]
    assert largest(compressed.sh[:, 1:] - higher) <= 1 / 64 + FLOAT
    assert largest(spz.sh[:, 1:4] - higher[:, :3]) <= 1 / 32 + FLOAT
    assert largest(spz.sh[:, 4:] - higher[:, 3:]) <= 1 / 16 + FLOAT


@pytest.mark.parametrize("extension", LOSSY)
def test_writing_again_what_was_read_changes_nothing_more(
    tmp_path: Path, make_gaussians: MakeGaussians, extension: str
) -> None:
    once = round_trip(tmp_path, extension, make_gaussians(700, 2))
    twice = round_trip(tmp_path, extension, once)
    assert torch.allclose(twice.means, once.means, rtol=0, atol=1e-6)
    assert torch.allclose(twice.log_scales, once.log_scales, rtol=0, atol=1e-5)
    assert torch.allclose(twice.opacities, once.opacities, rtol=0, atol=1e-6)
    assert degrees_apart(once, twice) < 1.2


@pytest.mark.parametrize("extension", LOSSY)
def test_the_same_splat_gives_the_same_bytes(
    tmp_path: Path, make_gaussians: MakeGaussians, extension: str
) -> None:
    for name in ("x", "y"):
        io.write(tmp_path / f"{name}{extension}", make_gaussians(300, 1))
    first, second = ((tmp_path / f"{name}{extension}").read_bytes() for name in ("x", "y"))
    assert first == second


@pytest.mark.parametrize("extension", LOSSY)
def test_values_beyond_the_range_are_clipped(
    tmp_path: Path, make_gaussians: MakeGaussians, extension: str
) -> None:
    splats = make_gaussians(20, 1)
    extreme = replace(
        splats,
        log_scales=torch.tensor([-200.0, 0, 150]).expand(20, 3),
        opacity_logits=torch.linspace(-100, 100, 20),
        sh=splats.sh * 100,
    )
    back = round_trip(tmp_path, extension, extreme)
    assert torch.isfinite(back.log_scales).all()
    assert (back.log_scales[:, 0] < -9).all()
    assert largest(back.opacities - extreme.opacities) <= ALPHA
    assert (back.sh.sign() == extreme.sh.sign())[:, 0].all()


# Files of other programs --------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        "splat-transform.compressed.ply",
        "splat-transform.sog",
        "ply2splat.splat",
        "niantic-v2.spz",
        "niantic-v3.spz",
        "niantic-v4.spz",
        "gaussian-splats-3d-0.ksplat",
        "gaussian-splats-3d-1.ksplat",
        "gaussian-splats-3d-2.ksplat",
    ],
)
def test_files_of_other_programs_are_read(name: str) -> None:
    expected, found = known(), io.read(WRITTEN_BY_OTHERS / name)
    # Some change the order, and round down.
    found = found.select(found.means[:, 0].argsort())
    assert largest(found.means - expected.means) < 1e-3
    assert largest(found.log_scales - expected.log_scales) <= 1 / 32 + FLOAT
    assert largest(found.opacities - expected.opacities) <= 1 / 255 + FLOAT
    assert largest(colours(found) - colours(expected)) <= 1 / 255 + FLOAT
    assert degrees_apart(found, expected) < 1.5
    if not name.endswith(".splat"):
        assert largest(found.sh[:, 1:] - expected.sh[:, 1:]) <= 1 / 16 + FLOAT


def test_a_compressed_ply_is_known_by_what_it_holds(
    tmp_path: Path, make_gaussians: MakeGaussians
) -> None:
    round_trip(tmp_path, ".compressed.ply", make_gaussians(300, 1))
    renamed = (tmp_path / "x.compressed.ply").rename(tmp_path / "y.ply")
    stored = PlyData.read(renamed)
    assert [element.name for element in stored.elements] == ["chunk", "vertex", "sh"]
    assert "a comment" in stored.comments
    assert len(io.read(renamed)) == 300
    # And a plain one under that name is a plain one.
    io.write(tmp_path / "z.ply", make_gaussians(30))
    (tmp_path / "z.ply").rename(tmp_path / "z.compressed.ply")
    assert len(io.read(tmp_path / "z.compressed.ply")) == 30


def test_older_compressed_plys_bound_no_colours(tmp_path: Path) -> None:
    stored = PlyData.read(WRITTEN_BY_OTHERS / "splat-transform.compressed.ply")
    bounds = stored["chunk"].data
    kept = [name for name in bounds.dtype.names if name[4:] not in ("r", "g", "b")]
    chunk = np.empty(len(bounds), [(name, "f4") for name in kept])
    for name in kept:
        chunk[name] = bounds[name]
    PlyData([PlyElement.describe(chunk, "chunk"), stored["vertex"]]).write(tmp_path / "old.ply")
    words = stored["vertex"].data["packed_color"]
    shown = colours(io.read(tmp_path / "old.ply"))
    assert torch.allclose(shown[:, 0], torch.from_numpy((words >> 24) / 255).float(), atol=1e-6)


def test_names_and_extensions() -> None:
    assert io.extension_of("a/Head.Compressed.PLY") == ".compressed.ply"
    assert io.stem_of("a/Head.Compressed.PLY") == "Head"
    assert (io.extension_of("b.c.ply"), io.stem_of("b.c.ply")) == (".ply", "b.c")
    assert (io.extension_of("b.obj"), io.stem_of("b.obj")) == (".obj", "b")
    assert (io.extension_of("b"), io.stem_of("b")) == ("", "b")
    assert io.extension_of("x/meta.json") == "meta.json"
    assert io.extension_of("x/ymeta.json") == ".json"


# Bad input ----------------------------------------------------------------------------------


@pytest.mark.parametrize("extension", LOSSY)
def test_missing_empty_truncated_and_foreign_files(
    tmp_path: Path, make_gaussians: MakeGaussians, extension: str
) -> None:
    path = tmp_path / f"x{extension}"
    refused(path, "No such file")
    path.touch()
    refused(path, "is empty")
    path.write_bytes(b"hello\n")
    refused(path, "expected" if extension == ".spz" else "another format")
    io.write(path, make_gaussians(300, 1))
    whole = path.read_bytes()
    for keep in (0.01, 0.1, 0.5, 0.99):
        path.write_bytes(whole[: 1 + int(len(whole) * keep)])
        refused(path, "truncated")


def test_noise_is_no_splat_file(tmp_path: Path) -> None:
    (tmp_path / "x.splat").write_bytes(np.random.default_rng(0).bytes(3200))
    refused(tmp_path / "x.splat", "scale of 0 or less")


def test_not_a_number_in_a_splat_file(tmp_path: Path, make_gaussians: MakeGaussians) -> None:
    io.write(tmp_path / "x.splat", make_gaussians(9))
    data = bytearray((tmp_path / "x.splat").read_bytes())
    data[3 * 32 : 3 * 32 + 4] = struct.pack("<f", float("nan"))
    (tmp_path / "x.splat").write_bytes(data)
    refused(tmp_path / "x.splat", "1 splat (number 3)", "positions")


@pytest.mark.parametrize(
    ("at", "value", "word"),
    [
        (0, 0x99, "no SPZ"),
        (4, 0, "version 0"),
        (4, 5, "version 5"),
        (8, 0, "0 splats"),
        (8, 10, "truncated"),
        (12, 9, "SH degree 9"),
    ],
)
def test_headers_of_spz_that_are_not_ours(
    tmp_path: Path, make_gaussians: MakeGaussians, at: int, value: int, word: str
) -> None:
    io.write(tmp_path / "x.spz", make_gaussians(9))
    data = bytearray(gzip.decompress((tmp_path / "x.spz").read_bytes()))
    data[at] = value
    (tmp_path / "x.spz").write_bytes(gzip.compress(data))
    refused(tmp_path / "x.spz", word)


@pytest.mark.parametrize("keep", [20, 60, 150, -1])
def test_spz_of_version_4_cut_off(tmp_path: Path, keep: int) -> None:
    whole = (WRITTEN_BY_OTHERS / "niantic-v4.spz").read_bytes()
    (tmp_path / "x.spz").write_bytes(whole[:keep])
    refused(tmp_path / "x.spz", "truncated")


@pytest.mark.parametrize("element", ["chunk", "sh", "vertex"])
def test_compressed_plys_whose_parts_do_not_fit(tmp_path: Path, element: str) -> None:
    stored = PlyData.read(WRITTEN_BY_OTHERS / "splat-transform.compressed.ply")
    rest = [one for one in stored.elements if one.name != element]
    PlyData(rest).write(tmp_path / "without.ply")
    short = PlyElement.describe(stored[element].data[:0], element)
    PlyData([*rest, short]).write(tmp_path / "short.ply")
    if element == "sh":
        assert io.read(tmp_path / "without.ply").sh_degree == 0
        refused(tmp_path / "short.ply", "0 of 5")
    else:
        refused(tmp_path / "without.ply", {"chunk": "min_x", "vertex": "no vertices"}[element])
        refused(tmp_path / "short.ply", {"chunk": "0 chunks", "vertex": "0 splats"}[element])


@pytest.mark.parametrize("extension", LOSSY)
def test_what_is_not_finite_is_not_written(
    tmp_path: Path, make_gaussians: MakeGaussians, extension: str
) -> None:
    splats = make_gaussians(9)
    splats.means[4, 1] = float("inf")
    with pytest.raises(WriteError, match="positions"):
        io.write(tmp_path / f"x{extension}", splats)
    with pytest.raises(WriteError, match="nothing"):
        io.write(tmp_path / f"x{extension}", splats.select(torch.arange(0)))
    assert not list(tmp_path.iterdir())


def test_coordinates_too_large_for_spz(tmp_path: Path, make_gaussians: MakeGaussians) -> None:
    splats = make_gaussians(9)
    with pytest.raises(WriteError, match="4194303"):
        io.write(tmp_path / "x.spz", replace(splats, means=splats.means * 1e7))
