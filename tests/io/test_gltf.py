"""glTF: splats as the extension of Khronos lays them out, wherever their nodes put them."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from splatmorph import io
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import SH0
from splatmorph.geometry.quaternions import from_matrices, to_matrices
from splatmorph.io.axes import upright
from splatmorph.io.packed import FAINTEST

MakeGaussians = Callable[..., Gaussians]
SPLATS = "KHR_gaussian_splatting"


def covariances(splats: Gaussians) -> torch.Tensor:
    half = to_matrices(splats.quats.double()) * splats.scales.double()[:, None]
    return half @ half.mT


def content_of(path: Path) -> tuple[dict[str, Any], bytes]:
    """JSON and data of a GLB file."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def write_json(path: Path, content: dict[str, Any], data: bytes) -> Path:
    uri = base64.b64encode(data).decode()
    content["buffers"] = [{"byteLength": len(data), "uri": f"data:;base64,{uri}"}]
    path.write_text(json.dumps(content))
    return path


Written = tuple[Gaussians, dict[str, Any], bytes]


@pytest.fixture
def written(tmp_path: Path, make_gaussians: MakeGaussians) -> Written:
    splats = make_gaussians(30, 1)
    io.write(tmp_path / "x.glb", splats)
    return splats, *content_of(tmp_path / "x.glb")


# Laws ---------------------------------------------------------------------------------------


@settings(max_examples=20, deadline=None)
@given(
    n=st.integers(1, 60),
    degree=st.integers(0, 4),
    seed=st.integers(0, 99),
    extension=st.sampled_from([".glb", ".gltf"]),
)
def test_what_comes_back_is_rounded_to_floats(
    tmp_path_factory: pytest.TempPathFactory,
    make_gaussians: MakeGaussians,
    n: int,
    degree: int,
    seed: int,
    extension: str,
) -> None:
    splats = make_gaussians(n, degree, seed)
    path = tmp_path_factory.mktemp("gltf") / f"x{extension}"
    io.write(path, splats, ["half way"])
    back = io.read(path)
    assert back.up == "y"
    assert torch.equal(back.means, splats.means)
    assert back.sh_degree == min(degree, 3)
    assert torch.equal(back.sh, splats.with_sh_degree(back.sh_degree).sh)
    assert torch.allclose(back.log_scales, splats.log_scales, atol=1e-5)
    assert torch.allclose(back.opacities, splats.opacities, atol=2 * FAINTEST)
    assert torch.allclose(covariances(back), covariances(splats), rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("up", ["-y", "z"])
def test_splats_stand_on_y_in_the_file(
    tmp_path: Path, make_gaussians: MakeGaussians, up: str
) -> None:
    splats = replace(make_gaussians(30, 2), up=up)
    io.write(tmp_path / "x.glb", splats)
    assert torch.equal(io.read(tmp_path / "x.glb").means, upright(splats, "y").means)


def test_what_is_far_from_the_origin_keeps_its_detail(
    tmp_path: Path, make_gaussians: MakeGaussians
) -> None:
    splats = replace(make_gaussians(30, 0), offset=(500_000.0, 0.0, 4_100_000.0))
    io.write(tmp_path / "x.glb", splats)
    assert torch.equal(io.read(tmp_path / "x.glb").absolute_means, splats.absolute_means)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 999), even=st.booleans())
def test_nodes_move_splats_as_the_specification_says(
    tmp_path_factory: pytest.TempPathFactory,
    make_gaussians: MakeGaussians,
    seed: int,
    even: bool,
) -> None:
    folder = tmp_path_factory.mktemp("nodes")
    splats = make_gaussians(20, 1, seed)
    io.write(folder / "x.glb", splats)
    content, data = content_of(folder / "x.glb")
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    w, x, y, z = from_matrices(torch.from_numpy(turn)).tolist()
    sizes = np.full(3, rng.uniform(0.5, 2)) if even else rng.uniform(0.5, 2, 3)
    shift, above = rng.normal(size=3), rng.normal(size=3)
    content["nodes"] = [
        {"children": [1], "translation": above.tolist()},
        {
            "mesh": 0,
            "rotation": [x, y, z, w],
            "scale": sizes.tolist(),
            "translation": shift.tolist(),
        },
    ]
    back = io.read(write_json(folder / "y.gltf", content, data))
    linear = torch.from_numpy(turn * sizes)
    means = splats.means.double() @ linear.T + torch.from_numpy(shift + above)
    assert torch.allclose(back.absolute_means, means, atol=1e-6)
    expected = linear @ covariances(splats) @ linear.T
    assert torch.allclose(covariances(back), expected, rtol=1e-4, atol=1e-7)


def test_a_matrix_says_the_same_as_its_parts(written: Written, tmp_path: Path) -> None:
    splats, content, data = written
    matrix = np.eye(4)
    matrix[:3, 3] = 1, 2, 3
    content["nodes"] = [{"mesh": 0, "matrix": matrix.T.ravel().tolist()}]
    back = io.read(write_json(tmp_path / "y.gltf", content, data))
    assert torch.allclose(back.means, splats.means + torch.tensor([1.0, 2, 3]))


# Other layouts ------------------------------------------------------------------------------


def test_numbers_may_be_small_integers(written: Written, tmp_path: Path) -> None:
    splats, content, data = written
    names = content["meshes"][0]["primitives"][0]["attributes"]
    quats = splats.quats / splats.quats.norm(dim=1, keepdim=True)
    stored = {
        "ROTATION": (5122, np.round(quats.roll(-1, 1).numpy() * 32767).astype("<i2")),
        "OPACITY": (5121, np.round(splats.opacities.numpy() * 255).astype("u1")[:, None]),
        "SCALE": (5123, np.round(splats.scales.numpy() * 65535).astype("<u2")),
    }
    for name, (kind, array) in stored.items():
        # As many bytes to a splat as a multiple of four.
        row = -(-array.itemsize * array.shape[1] // 4) * 4
        padded = np.zeros((len(array), row), "u1")
        padded[:, : array.itemsize * array.shape[1]] = array.view("u1").reshape(len(array), -1)
        content["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(data), "byteLength": padded.nbytes, "byteStride": row}
        )
        data += padded.tobytes()
        accessor = content["accessors"][names[f"{SPLATS}:{name}"]]
        accessor |= {"componentType": kind, "normalized": True}
        accessor["bufferView"] = len(content["bufferViews"]) - 1
    back = io.read(write_json(tmp_path / "y.gltf", content, data))
    assert torch.allclose(back.scales, splats.scales, atol=1 / 65535)
    assert torch.allclose(back.opacities, splats.opacities, atol=0.5 / 255 + 1e-6)
    assert torch.allclose(covariances(back), covariances(splats), atol=1e-3)


def test_spz_inside_is_read(written: Written, tmp_path: Path) -> None:
    splats, content, _ = written
    io.write(tmp_path / "x.spz", splats)
    plain = io.read(tmp_path / "x.spz")
    data = (tmp_path / "x.spz").read_bytes()
    content["bufferViews"] = [{"buffer": 0, "byteLength": len(data)}]
    spz = {"KHR_gaussian_splatting_compression_spz_2": {"bufferView": 0}}
    draft = {"KHR_spz_gaussian_splats_compression": {"bufferView": 0}}
    for extensions in ({SPLATS: {"kernel": "ellipse", "extensions": spz}}, draft):
        content["meshes"][0]["primitives"][0] = {"attributes": {}, "extensions": extensions}
        back = io.read(write_json(tmp_path / "y.gltf", content, data))
        assert torch.equal(back.means, plain.means)
        assert torch.equal(back.sh, plain.sh)


def test_all_splats_of_the_scene_are_one(written: Written, tmp_path: Path) -> None:
    splats, content, data = written
    content["nodes"] = [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}, {"mesh": 0}]
    content["scenes"] = [{"nodes": [2]}, {"nodes": [0, 1]}]
    content["scene"] = 1
    back = io.read(write_json(tmp_path / "y.gltf", content, data))
    assert len(back) == 60
    assert torch.allclose(back.means[30:], splats.means + torch.tensor([5.0, 0, 0]))


def test_linear_colours_are_shown_as_srgb(written: Written, tmp_path: Path) -> None:
    splats, content, data = written
    primitive = content["meshes"][0]["primitives"][0]
    primitive["extensions"][SPLATS]["colorSpace"] = "lin_rec709_display"
    back = io.read(write_json(tmp_path / "y.gltf", content, data))
    linear = (0.5 + SH0 * splats.sh[:, 0]).double().clamp(min=0).numpy()
    shown = np.where(linear > 0.0031308, 1.055 * linear ** (1 / 2.4) - 0.055, 12.92 * linear)
    assert np.allclose(0.5 + SH0 * back.sh[:, 0].double(), shown, atol=1e-6)


def test_data_may_lie_in_a_file_beside(written: Written, tmp_path: Path) -> None:
    splats, content, data = written
    (tmp_path / "the data.bin").write_bytes(data)
    content["buffers"] = [{"byteLength": len(data), "uri": "the%20data.bin"}]
    (tmp_path / "y.gltf").write_text(json.dumps(content))
    assert torch.equal(io.read(tmp_path / "y.gltf").means, splats.means)


def test_viewers_of_points_see_linear_colours(written: Written) -> None:
    splats, content, data = written
    accessor = content["accessors"][content["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    view = content["bufferViews"][accessor["bufferView"]]
    rgba = np.frombuffer(data, "u1", view["byteLength"], view["byteOffset"]).reshape(-1, 4)
    shown = (0.5 + SH0 * splats.sh[:, 0]).clamp(0, 1).numpy()
    linear = np.where(shown > 0.04045, ((shown + 0.055) / 1.055) ** 2.4, shown / 12.92)
    assert np.abs(rgba[:, :3] / 255 - linear).max() <= 0.5 / 255 + 1e-6


# Bad input ----------------------------------------------------------------------------------


def changed(content: dict[str, Any], at: tuple[Any, ...], value: Any) -> dict[str, Any]:
    place = content
    for key in at[:-1]:
        place = place[key]
    place[at[-1]] = value
    return content


PRIMITIVE = ("meshes", 0, "primitives", 0)


@pytest.mark.parametrize(
    ("at", "value", "words"),
    [
        ((*PRIMITIVE, "extensions"), {}, ("no splats", "meshes")),
        ((*PRIMITIVE, "extensions", SPLATS, "kernel"), "cube", ("kernel 'cube'",)),
        ((*PRIMITIVE, "extensions", SPLATS, "colorSpace"), "aces", ("'aces'",)),
        ((*PRIMITIVE, "attributes", f"{SPLATS}:SCALE"), 99, ("y.gltf",)),
        ((*PRIMITIVE, "attributes"), {"POSITION": 0}, (f"{SPLATS}:SH_DEGREE_0",)),
        (("accessors", 0, "count"), 10**9, ("truncated",)),
        (("accessors", 0, "count"), -1, ("no sense",)),
        (("accessors", 0, "count"), 7, ("differ in their number",)),
        (("accessors", 0, "componentType"), 3, ("y.gltf",)),
        (("bufferViews", 0, "byteLength"), 10**12, ("beyond its buffer",)),
        (("nodes", 0, "scale"), [-1, 1, 1], ("mirrors",)),
        (("nodes", 0, "scale"), [0, 1, 1], ("flattens",)),
        (("nodes", 0, "children"), [0], ("circle",)),
        (("asset",), {"version": "1.0"}, ("version '1.0'",)),
        (("scene",), 4, ("y.gltf",)),
    ],
)
def test_documents_that_make_no_sense(
    written: Written, tmp_path: Path, at: tuple[Any, ...], value: Any, words: tuple[str, ...]
) -> None:
    _, content, data = written
    refused(write_json(tmp_path / "y.gltf", changed(content, at, value), data), *words)


@pytest.mark.parametrize("uri", ["../x.glb", "/etc/passwd", "https://example.org/x.bin", "no.bin"])
def test_data_elsewhere_is_not_fetched(written: Written, tmp_path: Path, uri: str) -> None:
    _, content, data = written
    content["buffers"] = [{"byteLength": len(data), "uri": uri}]
    (tmp_path / "y.gltf").write_text(json.dumps(content))
    words = ("No such file",) if uri == "no.bin" else ("beside it",)
    with pytest.raises(Exception, match=words[0]):
        io.read(tmp_path / "y.gltf")


@pytest.mark.parametrize("keep", [3, 11, 19, 100, 2000, -5])
def test_truncated_files(tmp_path: Path, written: Written, keep: int) -> None:
    whole = (tmp_path / "x.glb").read_bytes()
    (tmp_path / "x.glb").write_bytes(whole[:keep])
    refused(tmp_path / "x.glb")


def test_files_that_are_no_gltf(tmp_path: Path) -> None:
    (tmp_path / "x.gltf").write_text("{}")
    refused(tmp_path / "x.gltf", "no 'asset'")
    (tmp_path / "x.glb").write_bytes(struct.pack("<III", 0x46546C67, 1, 12))
    refused(tmp_path / "x.glb", "version 1")
