"""SOG: pictures of splats, bundled and not, and the codebooks that they point into."""

from __future__ import annotations

import io as streams
import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from refusals import refused

from splatmorph import io
from splatmorph.gaussians import Gaussians
from splatmorph.io.codebooks import codebook, grouped, nearest

MakeGaussians = Callable[..., Gaussians]


def degrees_apart(a: Gaussians, b: Gaussians) -> float:
    p, q = (x.quats.double() / x.quats.double().norm(dim=1, keepdim=True) for x in (a, b))
    chord = torch.minimum((p - q).norm(dim=1), (p + q).norm(dim=1))
    return float(torch.rad2deg(4 * torch.asin(chord / 2)).max())


def unbundled(path: Path) -> Path:
    """The same SOG as files in a folder."""
    folder = path.parent / "files"
    zipfile.ZipFile(path).extractall(folder)
    return folder / "meta.json"


# Laws ---------------------------------------------------------------------------------------


@settings(max_examples=20, deadline=None)
@given(
    n=st.integers(1, 700),
    degree=st.integers(0, 4),
    seed=st.integers(0, 999),
    unit=st.sampled_from([1e-3, 1.0, 1e4]),
)
def test_what_comes_back_is_within_the_bounds(
    tmp_path_factory: pytest.TempPathFactory,
    make_gaussians: MakeGaussians,
    n: int,
    degree: int,
    seed: int,
    unit: float,
) -> None:
    splats = make_gaussians(n, degree, seed)
    splats = replace(splats, means=splats.means * unit)
    path = tmp_path_factory.mktemp("sog") / "x.sog"
    io.write(path, splats)
    back = io.read(path)
    assert back.sh_degree == min(degree, 3)
    logs = [x.means.double().sign() * x.means.double().abs().log1p() for x in (splats, back)]
    step = (logs[0].amax(0) - logs[0].amin(0)) / 65535
    assert ((logs[0] - logs[1]).abs() <= 0.51 * step + 1e-6).all()
    assert degrees_apart(back, splats) <= 1.2
    assert float((back.opacities - splats.opacities).abs().max()) <= 0.5 / 255 + 1e-6
    for name in ("log_scales", "sh"):
        wanted = getattr(splats.with_sh_degree(back.sh_degree), name).double()
        error = (getattr(back, name).double() - wanted).square().mean().sqrt()
        assert error <= 0.03 * max(float(wanted.std()), 1e-9) + 1e-6


def test_the_same_splat_gives_the_same_bytes(tmp_path: Path, make_gaussians: MakeGaussians) -> None:
    for name in ("x", "y"):
        io.write(tmp_path / f"{name}.sog", make_gaussians(300, 1))
    assert (tmp_path / "x.sog").read_bytes() == (tmp_path / "y.sog").read_bytes()


def test_bundled_and_unbundled_are_the_same(tmp_path: Path, make_gaussians: MakeGaussians) -> None:
    splats = make_gaussians(300, 2)
    io.write(tmp_path / "x.sog", splats)
    (tmp_path / "head").mkdir()
    io.write(tmp_path / "head" / "meta.json", splats)
    bundled, loose = io.read(tmp_path / "x.sog"), io.read(tmp_path / "head" / "meta.json")
    assert torch.equal(bundled.sh, loose.sh)
    assert torch.equal(bundled.means, io.read(unbundled(tmp_path / "x.sog")).means)
    assert io.stem_of(tmp_path / "head" / "meta.json") == "head"
    assert "unbundled" in io.layout(tmp_path / "head" / "meta.json")


def test_colours_survive_where_nothing_is_seen(
    tmp_path: Path, make_gaussians: MakeGaussians
) -> None:
    splats = replace(make_gaussians(50, 0), opacity_logits=torch.full((50,), -50.0))
    io.write(tmp_path / "x.sog", splats)
    assert torch.allclose(io.read(tmp_path / "x.sog").sh, splats.sh, atol=1e-6)


# Codebooks ----------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(n=st.integers(1, 3000), seed=st.integers(0, 999), few=st.booleans())
def test_a_codebook_is_exact_for_few_and_near_for_many(n: int, seed: int, few: bool) -> None:
    rng = np.random.default_rng(seed)
    values = rng.standard_t(3, n)
    if few:
        values = np.round(values, 1).clip(-10, 10)
    book = codebook(values)
    assert book.shape == (256,)
    assert (np.diff(book) >= 0).all()
    index = nearest(values, book)
    assert np.array_equal(np.abs(values - book[index]), np.abs(values[:, None] - book).min(1))
    if len(np.unique(values)) <= 256:
        assert np.array_equal(book[index], values)
    even = np.linspace(values.min(), values.max(), 256)
    error, other = ((values - one[nearest(values, one)]) ** 2 for one in (book, even))
    assert error.sum() <= (1 if n > 2000 else 2) * other.sum() + 1e-12


def test_groups_part_the_rows() -> None:
    rows = np.random.default_rng(0).normal(size=(5000, 9)) * np.linspace(1, 3, 9)
    means, labels = grouped(rows, 700)
    assert len(means) == 700
    assert np.array_equal(np.unique(labels), np.arange(700))
    for i in (0, 311, 699):
        assert np.allclose(means[i], rows[labels == i].mean(axis=0))
    error = ((rows - means[labels]) ** 2).sum()
    assert error < 0.6 * ((rows - rows.mean(axis=0)) ** 2).sum()
    # Where few are wanted, or all are alike, that is what there is.
    assert np.array_equal(grouped(rows, 5000)[0], rows)
    same, labels = grouped(np.zeros((10, 3)), 4)
    assert len(same) == 4
    assert labels.max() == 3


# Version 1 ----------------------------------------------------------------------------------


def picture(pixels: np.ndarray) -> bytes:
    stream = streams.BytesIO()
    Image.fromarray(pixels).save(stream, "WEBP", lossless=True, exact=True)
    return stream.getvalue()


def test_version_1_lies_between_bounds(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    pixels = {
        name: rng.integers(0, 256, (4, 4, 4), dtype=np.uint8)
        for name in ("means_l", "means_u", "scales", "quats", "sh0")
    }
    pixels["quats"][..., :3] = 128
    pixels["quats"][..., 3] = 252 + 2
    files = {name: [f"{name}.webp"] for name in pixels}
    meta = {
        "means": {"shape": [15, 3], "mins": [-1, -1, -1], "maxs": [1, 2, 3]},
        "scales": {"mins": [-8, -8, -8], "maxs": [-2, -2, -2], "files": files["scales"]},
        "quats": {"files": files["quats"]},
        "sh0": {"mins": [-1, -1, -1, -5], "maxs": [1, 1, 1, 5], "files": files["sh0"]},
    }
    meta["means"]["files"] = files["means_l"] + files["means_u"]
    for name, values in pixels.items():
        (tmp_path / f"{name}.webp").write_bytes(picture(values))
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    back = io.read(tmp_path / "meta.json")
    assert len(back) == 15
    expected = -8 + 6 * (pixels["scales"].reshape(-1, 4)[:15, :3] / 255)
    assert np.allclose(back.log_scales, expected, atol=1e-6)
    logits = (-5 + 10 * (pixels["sh0"].reshape(-1, 4)[:15, 3] / 255)).astype("f4")
    assert np.allclose(back.opacity_logits, logits, atol=1e-4)
    assert torch.allclose(back.quats[:, 2], torch.tensor(1.0), atol=1e-3)
    assert "SOG 1" in io.layout(tmp_path / "meta.json")


# Bad input ----------------------------------------------------------------------------------


def rebundled(path: Path, change: Callable[[dict[str, Any], dict[str, bytes]], None]) -> Path:
    with zipfile.ZipFile(path) as bundle:
        files = {name: bundle.read(name) for name in bundle.namelist()}
    meta = json.loads(files["meta.json"])
    change(meta, files)
    files["meta.json"] = json.dumps(meta).encode()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as bundle:
        for name, data in files.items():
            bundle.writestr(name, data)
    return path


def small(meta: dict[str, Any], files: dict[str, bytes]) -> None:
    files["quats.webp"] = picture(np.zeros((4, 4, 4), np.uint8))


def large(meta: dict[str, Any], files: dict[str, bytes]) -> None:
    files["quats.webp"] = picture(np.zeros((4000, 4000, 4), np.uint8))


def no_webp(meta: dict[str, Any], files: dict[str, bytes]) -> None:
    stream = streams.BytesIO()
    Image.new("RGBA", (20, 20)).save(stream, "PNG")
    files["quats.webp"] = stream.getvalue()


def bomb(meta: dict[str, Any], files: dict[str, bytes]) -> None:
    files["quats.webp"] = bytes(100_000_000)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda meta, files: meta.update(version=3), ("version 3",)),
        (lambda meta, files: meta.update(count=0), ("0 splats",)),
        (lambda meta, files: meta.update(count=10**9), ("promises",)),
        (lambda meta, files: meta.update(count=400), ("fewer pixels",)),
        (lambda meta, files: meta.pop("sh0"), ("no SOG",)),
        (lambda meta, files: meta["sh0"].update(files=["../x.webp"]), ("x.sog",)),
        (lambda meta, files: meta["sh0"].update(codebook=[1.0]), ("x.sog",)),
        (lambda meta, files: meta["scales"].update(codebook=[float("nan")] * 256), ("scales",)),
        (lambda meta, files: files.pop("quats.webp"), ("quats.webp",)),
        (small, ("fewer pixels",)),
        (large, ("far more pixels",)),
        (no_webp, ("x.sog",)),
        (bomb, ("promises",)),
    ],
)
def test_bundles_that_make_no_sense(
    tmp_path: Path,
    make_gaussians: MakeGaussians,
    change: Callable[[dict[str, Any], dict[str, bytes]], None],
    words: tuple[str, ...],
) -> None:
    io.write(tmp_path / "x.sog", make_gaussians(300, 1))
    refused(rebundled(tmp_path / "x.sog", change), *words)


@pytest.mark.parametrize("name", ["../sh0.webp", "/etc/passwd", ""])
def test_pictures_elsewhere_are_not_read(
    tmp_path: Path, make_gaussians: MakeGaussians, name: str
) -> None:
    io.write(tmp_path / "x.sog", make_gaussians(30))
    path = unbundled(tmp_path / "x.sog")
    meta = json.loads(path.read_text())
    meta["sh0"]["files"] = [name]
    path.write_text(json.dumps(meta))
    refused(path, "beside it")


@pytest.mark.parametrize("keep", [3, 100, 0.5, 0.99])
def test_truncated_bundles(tmp_path: Path, make_gaussians: MakeGaussians, keep: float) -> None:
    io.write(tmp_path / "x.sog", make_gaussians(300))
    whole = (tmp_path / "x.sog").read_bytes()
    (tmp_path / "x.sog").write_bytes(whole[: int(keep if keep > 1 else keep * len(whole))])
    refused(tmp_path / "x.sog")


def test_other_json_is_no_sog(tmp_path: Path) -> None:
    (tmp_path / "meta.json").write_text('{"means": 1}')
    refused(tmp_path / "meta.json", "no SOG")
