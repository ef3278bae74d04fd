"""PLY: what is read is what was stored, bit for bit; what is wrong is refused in one line."""

from __future__ import annotations

import errno
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement
from plys import stored_columns, write_columns
from refusals import refused

from splatmorph import io
from splatmorph.errors import LocalFrameError, OptionError, WriteError
from splatmorph.gaussians import UPS, Gaussians
from splatmorph.io import elements
from splatmorph.io.atomic import atomic_write
from splatmorph.io.ply import read_properties

FIELDS = ("means", "quats", "log_scales", "opacity_logits", "sh")
MakeGaussians = Callable[..., Gaussians]


def assert_identical(a: Gaussians, b: Gaussians) -> None:
    for name in FIELDS:
        left, right = getattr(a, name), getattr(b, name)
        assert left.dtype == right.dtype == torch.float32
        assert left.numpy().tobytes() == right.numpy().tobytes(), name
    assert a.extras.keys() == b.extras.keys()
    for name in a.extras:
        assert torch.equal(a.extras[name], b.extras[name]), name


@pytest.fixture
def columns(tmp_path: Path, make_gaussians: MakeGaussians) -> dict[str, np.ndarray]:
    io.write(tmp_path / "plain.ply", make_gaussians(40))
    return stored_columns(tmp_path / "plain.ply")


# Laws ---------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(
    n=st.integers(1, 40),
    degree=st.integers(0, 4),
    seed=st.integers(0, 999),
    logit=st.sampled_from([20.0, -20.0, 88.0, 0.0]),
    length=st.sampled_from([1e-4, 1.0, 3e5]),
)
def test_written_then_read_is_the_same_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory,
    make_gaussians: MakeGaussians,
    n: int,
    degree: int,
    seed: int,
    logit: float,
    length: float,
) -> None:
    splats = make_gaussians(n, degree, seed)
    logits = splats.opacity_logits.clone()
    logits[0] = logit
    splats = replace(splats, opacity_logits=logits, quats=splats.quats * length)
    path = tmp_path_factory.mktemp("ply") / "x.ply"
    io.write(path, splats)
    assert_identical(io.read(path), splats)


@pytest.mark.parametrize(("text", "byte_order"), [(True, "="), (False, "<"), (False, ">")])
def test_any_order_and_encoding_reads_the_same(
    tmp_path: Path,
    make_gaussians: MakeGaussians,
    columns: dict[str, np.ndarray],
    text: bool,
    byte_order: str,
) -> None:
    shuffled = {name: columns[name] for name in sorted(columns, key=lambda name: name[::-1])}
    for name in ("nx", "ny", "nz"):
        del shuffled[name]
    write_columns(tmp_path / "y.ply", shuffled, text=text, byte_order=byte_order)
    assert_identical(io.read(tmp_path / "y.ply"), make_gaussians(40))


def test_doubles_and_mixed_types_are_read(
    tmp_path: Path, make_gaussians: MakeGaussians, columns: dict[str, np.ndarray]
) -> None:
    mixed = {name: v.astype("f8" if name in "xyz" else "f4") for name, v in columns.items()}
    write_columns(tmp_path / "y.ply", mixed, byte_order=">")
    assert_identical(io.read(tmp_path / "y.ply"), make_gaussians(40))


@pytest.mark.parametrize("kind", ["u1", "i2", "u2", "i4", "u4", "f4", "f8"])
def test_unknown_properties_are_kept(
    tmp_path: Path, columns: dict[str, np.ndarray], kind: str
) -> None:
    top = 2**31 + 7 if kind == "u4" else 100
    label = (np.arange(40) % 7).astype(kind)
    label[0] = top
    write_columns(tmp_path / "y.ply", columns | {"label": label})
    splats = io.read(tmp_path / "y.ply")
    io.write(tmp_path / "z.ply", splats)
    again = stored_columns(tmp_path / "z.ply")["label"]
    assert np.array_equal(again.astype(np.float64), label.astype(np.float64))


def test_normals_that_say_something_are_kept(
    tmp_path: Path, columns: dict[str, np.ndarray]
) -> None:
    normals = {"nx": np.arange(40, dtype="f4"), "ny": columns["ny"], "nz": columns["nz"]}
    write_columns(tmp_path / "y.ply", columns | normals)
    io.write(tmp_path / "z.ply", io.read(tmp_path / "y.ply"))
    assert np.array_equal(stored_columns(tmp_path / "z.ply")["nx"], normals["nx"])


def test_the_layout_is_inrias(tmp_path: Path, make_gaussians: MakeGaussians) -> None:
    splats = replace(make_gaussians(3, 3), up="y")
    io.write(tmp_path / "x.ply", splats, ["splatmorph t=0.5 source=a target=b"])
    stored = PlyData.read(tmp_path / "x.ply")
    rest = [f"f_rest_{i}" for i in range(45)]
    expected = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *rest, "opacity"]
    expected += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    data = stored["vertex"].data
    assert list(data.dtype.names) == expected
    assert {data.dtype[name].str for name in expected} == {"<f4"}
    # f_rest is channel-major: all of red, then green, then blue.
    assert data["f_rest_15"][1] == splats.sh[1, 1, 1].numpy()
    assert stored.comments[0].startswith("Generated by splatmorph ")
    assert stored.comments[1:] == ["Vertical Axis: y", "splatmorph t=0.5 source=a target=b"]


def test_real_heads_come_back_byte_for_byte(tmp_path: Path, shared_data: Path) -> None:
    for head in (shared_data / "heads").glob("*.ply"):
        io.write(tmp_path / head.name, io.read(head))
        before, after = stored_columns(head), stored_columns(tmp_path / head.name)
        for name in before:
            assert before[name].tobytes() == after[name].tobytes(), (head.name, name)


def test_statues_in_another_order_are_read(shared_data: Path) -> None:
    assert len(io.read(shared_data / "objects" / "angel.ply")) == 71_359


# Bad input ----------------------------------------------------------------------------------


def test_missing_empty_and_foreign_files(tmp_path: Path) -> None:
    refused(tmp_path / "no.ply", "No such file")
    (tmp_path / "empty.ply").touch()
    refused(tmp_path / "empty.ply", "is empty")
    (tmp_path / "text.ply").write_text("hello\n")
    refused(tmp_path / "text.ply", "PLY")
    (tmp_path / "noise.ply").write_bytes(np.random.default_rng(0).bytes(4000))
    refused(tmp_path / "noise.ply", "PLY")
    (tmp_path / "x.foo").write_text("v 0 0 0\n")
    refused(tmp_path / "x.foo", "extension", ".ply")
    refused(tmp_path, "directory")


@pytest.mark.parametrize("keep", [0.03, 0.3, 0.9, 0.999])
def test_truncated_files(tmp_path: Path, make_gaussians: MakeGaussians, keep: float) -> None:
    io.write(tmp_path / "x.ply", make_gaussians(300))
    whole = (tmp_path / "x.ply").read_bytes()
    (tmp_path / "x.ply").write_bytes(whole[: int(len(whole) * keep)])
    refused(tmp_path / "x.ply", "no whole PLY")


def test_meshes_clouds_and_nothing(tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    position = {name: columns[name] for name in "xyz"}
    write_columns(tmp_path / "cloud.ply", position | {"red": np.zeros(40, "u1")})
    refused(tmp_path / "cloud.ply", "coloured point cloud")
    vertex = np.zeros(3, [(axis, "f4") for axis in "xyz"])
    face = np.array([([0, 1, 2],)], [("vertex_indices", "i4", (3,))])
    mesh = PlyData([PlyElement.describe(vertex, "vertex"), PlyElement.describe(face, "face")])
    mesh.write(tmp_path / "mesh.ply")
    refused(tmp_path / "mesh.ply", "a mesh")
    write_columns(tmp_path / "none.ply", {name: v[:0] for name, v in columns.items()})
    refused(tmp_path / "none.ply", "0 splats")
    partial = {name: v for name, v in columns.items() if not name.startswith("rot")}
    write_columns(tmp_path / "partial.ply", partial)
    refused(tmp_path / "partial.ply", "rot_0")


def test_an_avatar_without_its_mesh_is_recognised(
    tmp_path: Path, columns: dict[str, np.ndarray]
) -> None:
    write_columns(tmp_path / "local.ply", columns | {"binding_0": np.zeros(40, "f4")})
    refused(tmp_path / "local.ply", "GaussianAvatars", "mesh", error=LocalFrameError)
    assert "binding_0" in read_properties(tmp_path / "local.ply")


@pytest.mark.parametrize("count", [1, 8, 10, 44])
def test_sh_counts_that_fit_no_degree(
    tmp_path: Path, columns: dict[str, np.ndarray], count: int
) -> None:
    for i in range(9):
        del columns[f"f_rest_{i}"]
    rest = {f"f_rest_{i}": np.zeros(40, "f4") for i in range(count)}
    write_columns(tmp_path / "x.ply", columns | rest)
    refused(tmp_path / "x.ply", f"{count} f_rest", "9, 24, 45")


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("x", np.nan, ("positions", "number 3")),
        ("z", -np.inf, ("positions", "number 3")),
        ("opacity", np.nan, ("opacities", "±20")),
        ("scale_1", np.nan, ("scales",)),
        ("rot_2", np.inf, ("quaternions",)),
        ("f_rest_4", np.nan, ("colours",)),
    ],
)
def test_values_that_are_not_finite(
    tmp_path: Path,
    columns: dict[str, np.ndarray],
    field: str,
    value: float,
    words: tuple[str, ...],
) -> None:
    columns[field][3] = value
    write_columns(tmp_path / "x.ply", columns)
    refused(tmp_path / "x.ply", "1 splat ", *words)


def test_zero_quaternions(tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    for i in range(4):
        columns[f"rot_{i}"][5:7] = 0
    write_columns(tmp_path / "x.ply", columns)
    refused(tmp_path / "x.ply", "2 splats", "number 5", "zero quaternion")


def test_activated_values_are_recognised(tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    alphas = 1 / (1 + np.exp(-columns["opacity"]))
    write_columns(tmp_path / "a.ply", columns | {"opacity": alphas})
    refused(tmp_path / "a.ply", "opacities already activated")
    scales = {f"scale_{i}": np.exp(columns[f"scale_{i}"]) for i in range(3)}
    write_columns(tmp_path / "s.ply", columns | scales)
    refused(tmp_path / "s.ply", "scales already activated")


def test_large_units_are_no_mistake(tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    grown = {axis: columns[axis] * 1000 for axis in "xyz"}
    grown |= {f"scale_{i}": columns[f"scale_{i}"] + np.float32(np.log(1000)) for i in range(3)}
    write_columns(tmp_path / "mm.ply", columns | grown)
    assert io.read(tmp_path / "mm.ply").log_scales.min() > 0


# Writing ------------------------------------------------------------------------------------


def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, make_gaussians: MakeGaussians, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "x.ply"
    io.write(path, make_gaussians(5))
    before = path.read_bytes()

    def full(records: NDArray[Any]) -> bytes:
        if len(records) == 9:
            raise OSError(errno.ENOSPC, "No space left on device")
        return records.tobytes()

    monkeypatch.setattr(elements, "_bytes", full)
    with pytest.raises(WriteError, match="disk is full"):
        io.write(path, make_gaussians(9))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["x.ply"]


def test_outputs_that_cannot_be(tmp_path: Path, make_gaussians: MakeGaussians) -> None:
    with pytest.raises(WriteError, match="folder does not exist"):
        io.write(tmp_path / "no" / "x.ply", make_gaussians(2))
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(WriteError, match="is a directory"):
        io.write(tmp_path / "folder.ply", make_gaussians(2))
    with pytest.raises(OptionError, match="extension"):
        io.write(tmp_path / "x.xyz", make_gaussians(2))


def test_an_interrupt_in_the_middle_leaves_nothing(tmp_path: Path) -> None:
    def write_half() -> None:
        with atomic_write(tmp_path / "x.txt") as partial:
            partial.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("extension", [".ply", ".compressed.ply"])
@pytest.mark.parametrize("up", [*UPS, None])
def test_which_axis_is_up_is_kept_and_never_made_up(
    up: str | None, extension: str, tmp_path: Path, make_gaussians: MakeGaussians
) -> None:
    io.write(tmp_path / f"x{extension}", replace(make_gaussians(3), up=up))
    assert io.read(tmp_path / f"x{extension}").up == up


@pytest.mark.parametrize(
    ("comment", "up"),
    [("Vertical Axis: z", "z"), ("vertical axis: -Y", "-y"), ("Vertical Axis: +z", "z"),
     ("Vertical Axis: sideways", None), ("my Vertical Axis: z", None)],
)  # fmt: skip
def test_others_say_which_axis_is_up(
    comment: str, up: str | None, tmp_path: Path, columns: dict[str, np.ndarray]
) -> None:
    write_columns(tmp_path / "y.ply", columns)
    text = (tmp_path / "y.ply").read_bytes()
    (tmp_path / "y.ply").write_bytes(
        text.replace(b"element", f"comment {comment}\nelement".encode(), 1)
    )
    assert io.read(tmp_path / "y.ply").up == up


@pytest.mark.parametrize("kind", ["f8", "f4"])
@pytest.mark.parametrize(
    "middle", [(480_000.0, 5_400_000.0, 210.0), (0.0, 0.0, 6.4e6), (3.0, 0, 0)]
)
def test_far_coordinates_keep_their_detail_and_come_back(
    kind: str, middle: tuple[float, ...], tmp_path: Path, columns: dict[str, np.ndarray]
) -> None:
    far = {
        name: (columns[name].astype("f8") + shift).astype(kind)
        for name, shift in zip("xyz", middle, strict=True)
    }
    write_columns(tmp_path / "y.ply", columns | far)
    splats = io.read(tmp_path / "y.ply")
    if max(middle) > 1e5:
        assert splats.means.abs().max() < 20
        assert any(splats.offset)
    exact = np.stack([far[name] for name in "xyz"], axis=1)
    np.testing.assert_allclose(splats.absolute_means, exact, rtol=0, atol=1e-6)
    io.write(tmp_path / "z.ply", splats)
    again = stored_columns(tmp_path / "z.ply")
    for name in "xyz":
        np.testing.assert_allclose(again[name], far[name], rtol=0, atol=1e-6)
        if kind == "f4":
            assert again[name].tobytes() == far[name].tobytes()
    assert again["scale_0"].tobytes() == columns["scale_0"].tobytes()


def test_near_coordinates_are_not_touched(tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    for factor in (1e-4, 1.0, 1e3):
        scaled = {name: (factor * columns[name]).astype("f4") for name in "xyz"}
        logs = {f"scale_{i}": columns[f"scale_{i}"] + np.log(factor).astype("f4") for i in range(3)}
        write_columns(tmp_path / "y.ply", columns | scaled | logs)
        splats = io.read(tmp_path / "y.ply")
        assert not any(splats.offset)
        assert splats.means[:, 0].numpy().tobytes() == scaled["x"].tobytes()
