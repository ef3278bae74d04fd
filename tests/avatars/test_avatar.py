"""Avatars as users have them: where files lie, poses, landmarks, and what is wrong with them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import flame_twin
import numpy as np
import pytest
import synthetic_flame
import torch
from mesh_avatars import mesh_avatar
from plyfile import PlyData

from splatmorph import io
from splatmorph.avatars import (
    baked,
    is_avatar,
    load_avatar,
    pose_warnings,
    summarize,
    track_of,
)
from splatmorph.errors import LocalFrameError, OptionError, ReadError
from splatmorph.fitting import FitConfig, fit
from splatmorph.flows import make_flow
from splatmorph.landmarks import Landmarks
from splatmorph.morph import Morph

MESH = {"vertices": 5023, "faces": 9976}


def _inner(avatar: Path) -> Path:
    return avatar / "point_cloud" / "iteration_600000"


def _with_parameters(anna: Path, folder: Path, **changes: Any) -> Path:
    """Anna again, with other values in her flame_param.npz; None takes one out."""
    folder.mkdir()
    (folder / "point_cloud.ply").write_bytes((_inner(anna) / "point_cloud.ply").read_bytes())
    stored = synthetic_flame.parameters(4, 1) | changes
    np.savez(folder / "flame_param.npz", **{k: v for k, v in stored.items() if v is not None})
    return folder


# What is an avatar, and where its files are


def test_every_path_to_an_avatar_is_the_same_avatar(anna: Path, flame_folder: Path) -> None:
    wanted = load_avatar(anna, flame=flame_folder)
    for path in (_inner(anna), _inner(anna) / "point_cloud.ply", anna / "point_cloud"):
        found = load_avatar(path, flame=flame_folder / "flame2023.pkl")
        assert found.name == "anna"
        torch.testing.assert_close(found.gaussians.means, wanted.gaussians.means, rtol=0, atol=0)
        assert is_avatar(path)


def test_the_last_iteration_counts(tmp_path: Path) -> None:
    for iteration, splats in ((7000, 3), (30000, 5), (600, 4)):
        mesh_avatar(tmp_path / f"point_cloud/iteration_{iteration}", binding=range(splats))
    assert len(load_avatar(tmp_path).gaussians) == 5


def test_what_is_no_avatar(tmp_path: Path, anna: Path) -> None:
    plain = tmp_path / "plain.ply"
    io.write(plain, load_avatar(mesh_avatar(tmp_path / "mesh")).gaussians)
    assert not is_avatar(plain)
    assert not is_avatar(tmp_path)
    assert not is_avatar(tmp_path / "absent")
    assert not is_avatar(_inner(anna) / "flame_param.npz")
    with pytest.raises(ReadError, match=r"no property binding_0.*world space"):
        load_avatar(plain)
    with pytest.raises(ReadError, match="does not exist"):
        load_avatar(tmp_path / "absent")
    with pytest.raises(ReadError, match=r"holds no point_cloud\.ply"):
        load_avatar(tmp_path)


def test_a_local_file_is_no_plain_splat(anna: Path) -> None:
    with pytest.raises(LocalFrameError, match="bake it first"):
        io.read(_inner(anna) / "point_cloud.ply")


def test_flame_is_found_by_option_variable_or_checkout(
    anna: Path, flame_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert summarize(anna).flame_file is None
    assert summarize(anna, flame=flame_folder).flame_file == flame_folder / "flame2023.pkl"
    monkeypatch.setenv("SPLATMORPH_FLAME", str(flame_folder))
    assert summarize(anna).flame_file == flame_folder / "flame2023.pkl"
    monkeypatch.delenv("SPLATMORPH_FLAME")
    assets = tmp_path / "flame_model" / "assets" / "flame"
    assets.mkdir(parents=True)
    (assets / "generic_model.pkl").symlink_to(flame_folder / "flame2023.pkl")
    inside = _with_parameters(anna, tmp_path / "output")
    assert (
        summarize(inside).flame_file
        == (assets / "generic_model.pkl").resolve().parent / ("generic_model.pkl")
        or summarize(inside).flame_file == assets / "generic_model.pkl"
    )


def test_flame_is_not_taken_from_inside_the_avatar(
    anna: Path, flame_folder: Path, tmp_path: Path
) -> None:
    copied = tmp_path / "downloads" / "anna"
    shutil.copytree(anna, copied)
    for inside in (copied, copied / "point_cloud", copied / "point_cloud" / "iteration_600000"):
        assets = inside / "flame_model" / "assets" / "flame"
        assets.mkdir(parents=True)
        (assets / "flame2023.pkl").symlink_to(flame_folder / "flame2023.pkl")
    assert summarize(copied).flame_file is None
    above = copied.parent / "flame_model"
    shutil.copytree(copied / "flame_model", above, symlinks=True)
    assert summarize(copied).flame_file == above / "assets" / "flame" / "flame2023.pkl"


def test_missing_flame_says_how_to_get_it(anna: Path, tmp_path: Path) -> None:
    for arguments in ({}, {"flame": tmp_path}):
        with pytest.raises(ReadError, match=r"flame\.is\.tue\.mpg\.de.*SPLATMORPH_FLAME") as caught:
            load_avatar(anna, **arguments)
        assert "\n" not in str(caught.value)


def test_the_summary_needs_no_flame(anna: Path, ben: Path) -> None:
    found = summarize(anna)
    assert (found.name, found.splats, found.sh_degree, found.frames) == ("anna", 500, 3, 4)
    assert found.teeth
    assert not summarize(ben).teeth
    assert found.hint is not None
    assert "FLAME was not found" in found.hint


# Poses


def _twin_vertices(seed: int, frame: int | None) -> np.ndarray:
    stored = synthetic_flame.parameters(4, seed)
    model = synthetic_flame.model()
    shaped = model["v_template"] + stored["static_offset"][0, :5023]
    shaped = shaped + model["shapedirs"][:, :, :300] @ stored["shape"]
    if frame is None:
        return shaped
    shaped = shaped + model["shapedirs"][:, :, 300:] @ stored["expr"][frame]
    keys = ("rotation", "neck_pose", "jaw_pose", "eyes_pose")
    pose = np.concatenate([stored[key][frame] for key in keys]).reshape(5, 3)
    return flame_twin.skinned(model, shaped, pose) + stored["translation"][frame]


@pytest.mark.parametrize("frame", [None, 0, 3])
def test_a_posed_avatar_agrees_with_the_twin(
    anna: Path, flame_folder: Path, frame: int | None
) -> None:
    avatar = load_avatar(anna, flame=flame_folder, frame=frame)
    vertices = _twin_vertices(1, frame)
    np.testing.assert_allclose(avatar.vertices[:5023].numpy(), vertices, atol=1e-12)
    stored = PlyData.read(_inner(anna) / "point_cloud.ply")["vertex"]
    faces = synthetic_flame.model()["f"]
    for i in np.flatnonzero(stored["binding_0"] < 9976)[:40]:
        row = {name: float(stored[name][i]) for name in stored.data.dtype.names}
        mean, turn, scale = flame_twin.baked(
            np.array([row["x"], row["y"], row["z"]]),
            np.array([row[f"rot_{k}"] for k in range(4)]),
            np.array([row[f"scale_{k}"] for k in range(3)]),
            vertices[faces[int(row["binding_0"])]],
        )
        np.testing.assert_allclose(avatar.gaussians.means[i], mean, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(avatar.gaussians.scales[i], scale, rtol=1e-5)
        w, x, y, z = avatar.gaussians.quats[i].double().numpy()
        found = turn.from_quat([x, y, z, w])
        assert np.degrees((turn.inv() * found).magnitude()) < 1e-4
        # Channel-major: all of red, then green, then blue.
        rest = np.array([row[f"f_rest_{k}"] for k in range(45)]).reshape(3, 15).T
        np.testing.assert_array_equal(avatar.gaussians.sh[i, 1:], rest.astype(np.float32))
    np.testing.assert_array_equal(avatar.gaussians.opacity_logits, stored["opacity"])
    assert not avatar.gaussians.extras


def test_a_pose_can_come_from_another(anna: Path, ben: Path, flame_folder: Path) -> None:
    alike = [
        load_avatar(anna, frame=2, flame=flame_folder),
        load_avatar(ben, pose=anna, frame=2, flame=flame_folder),
    ]
    assert pose_warnings(*alike) == ()
    by_file = load_avatar(ben, pose=_inner(anna) / "flame_param.npz", frame=2, flame=flame_folder)
    torch.testing.assert_close(by_file.vertices, alike[1].vertices, rtol=0, atol=0)


def test_options_load_the_same_avatar_again(anna: Path, ben: Path, flame_folder: Path) -> None:
    first = load_avatar(ben, pose=anna, frame=1, flame=flame_folder, landmarks_set="dense")
    again = load_avatar(ben, **json.loads(json.dumps(dict(first.options))))
    torch.testing.assert_close(first.gaussians.means, again.gaussians.means, rtol=0, atol=0)
    assert first.landmarks.names == again.landmarks.names
    assert first.files == again.files
    assert {file.name for file in first.files} == {"point_cloud.ply", "flame_param.npz"}


def test_a_track_is_its_frames(anna: Path, flame_folder: Path) -> None:
    avatar = load_avatar(anna, flame=flame_folder)
    frames = list(baked(avatar.rig, track_of(anna)))
    assert len(frames) == 4
    one = load_avatar(anna, flame=flame_folder, frame=3)
    torch.testing.assert_close(frames[3].means, one.gaussians.means, rtol=0, atol=0)


def test_offsets_by_frame_are_one_s_own(
    anna: Path, ben: Path, tmp_path: Path, flame_folder: Path
) -> None:
    offset = np.zeros((4, 5143, 3), np.float32)
    offset[2, :, 1] = 0.01
    moving = _with_parameters(anna, tmp_path / "moving", dynamic_offset=offset)
    plain = load_avatar(anna, frame=2, flame=flame_folder).vertices
    own = load_avatar(moving, frame=2, flame=flame_folder).vertices
    by_name = load_avatar(moving, pose=moving, frame=2, flame=flame_folder).vertices
    assert (own - plain).norm(dim=1).median() > 0.005
    torch.testing.assert_close(by_name, own, rtol=0, atol=0)
    others = [load_avatar(ben, pose=p, frame=2, flame=flame_folder) for p in (anna, moving)]
    torch.testing.assert_close(others[0].vertices, others[1].vertices, rtol=0, atol=0)


def test_heads_posed_apart_are_told(anna: Path, ben: Path, flame_folder: Path) -> None:
    resting = load_avatar(anna, flame=flame_folder)
    assert pose_warnings(resting, load_avatar(ben, flame=flame_folder)) == ()
    moving = load_avatar(ben, frame=1, flame=flame_folder)
    (line,) = pose_warnings(resting, moving)
    assert "anna and ben are posed apart" in line
    assert "jaw by" in line
    assert "expression by" in line
    assert "can't open a mouth" in line
    assert pose_warnings(None, None) == ()
    (line,) = pose_warnings(None, moving)
    assert "the other a plain splat" in line


@pytest.mark.parametrize("frame", [-1, 4, 1000])
def test_frames_that_are_not_there(anna: Path, flame_folder: Path, frame: int) -> None:
    with pytest.raises(OptionError, match="frames 0 to 3"):
        load_avatar(anna, flame=flame_folder, frame=frame)


# Wrong splats


@pytest.mark.parametrize(
    ("binding", "words"),
    [
        ([0, 1.5], r"1 values of binding_0.*1\.5 of splat 1"),
        ([0, -1], "no face number"),
        ([0, np.nan], "no face number"),
        ([0, 9976], "trained with teeth"),
        ([0, 20000], "another mesh, or the file is damaged"),
    ],
)
def test_wrong_bindings(tmp_path: Path, binding: list[float], words: str) -> None:
    with pytest.raises(ReadError, match=words):
        load_avatar(mesh_avatar(tmp_path / "a", binding=binding))


def test_a_binding_beyond_the_teeth(tmp_path: Path, flame_folder: Path) -> None:
    synthetic_flame.write_local(tmp_path / "point_cloud.ply", np.array([0, 10144]))
    np.savez(tmp_path / "flame_param.npz", **synthetic_flame.parameters(2))
    with pytest.raises(ReadError, match="faces up to 10144, but FLAME with teeth has 10144"):
        load_avatar(tmp_path, flame=flame_folder)


# Wrong parameters


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"expr": np.full((4, 100), np.nan)}, "400 NaN or infinite values in 'expr'"),
        ({"jaw_pose": np.zeros((0, 3))}, "a track of 0 frames"),
        ({"expr": None}, "no 'expr'"),
        ({"neck_pose": np.zeros((3, 3))}, r"'neck_pose' of shape \(3, 3\), expected \(4, 3\)"),
        ({"expr": np.zeros((4, 101))}, "'expr' of shape"),
        ({"static_offset": np.zeros((1, 77, 3))}, "'static_offset' of shape"),
        ({"dynamic_offset": np.zeros((3, 5143, 3))}, "'dynamic_offset' of shape"),
        ({"shape": np.zeros(301)}, "expected up to 300 coefficients"),
        ({"shape": None}, "not whose it is"),
    ],
)
def test_wrong_parameters(anna: Path, tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    folder = _with_parameters(anna, tmp_path / "a", **changes)
    with pytest.raises(ReadError, match=words) as caught:
        load_avatar(folder)
    assert "\n" not in str(caught.value)


def test_a_damaged_parameter_file(anna: Path, tmp_path: Path) -> None:
    folder = _with_parameters(anna, tmp_path / "a")
    track = folder / "flame_param.npz"
    track.write_bytes(track.read_bytes()[:1000])
    with pytest.raises(ReadError, match=r"no whole \.npz"):
        load_avatar(folder)
    np.savez(track, expr=np.array([{}], dtype=object), jaw_pose=np.zeros((1, 3)))
    with pytest.raises(ReadError, match=r"no whole \.npz of a track"):
        load_avatar(folder)


def test_fewer_coefficients_and_missing_motions_are_zero(
    anna: Path, tmp_path: Path, flame_folder: Path
) -> None:
    stored = synthetic_flame.parameters(4, 1)
    few = {"shape": stored["shape"][None, :50], "expr": stored["expr"][:, :20]}
    missing = dict.fromkeys(("neck_pose", "eyes_pose", "translation", "static_offset"))
    padded = {
        "shape": np.where(np.arange(300) < 50, stored["shape"], 0),
        "expr": np.where(np.arange(100) < 20, stored["expr"], 0),
    }
    zero = {key: np.zeros_like(stored[key]) for key in missing}
    short = _with_parameters(anna, tmp_path / "short", **few, **missing)
    full = _with_parameters(anna, tmp_path / "full", **padded, **zero)
    poses = [load_avatar(folder, frame=1, flame=flame_folder).vertices for folder in (short, full)]
    torch.testing.assert_close(poses[0], poses[1], rtol=0, atol=1e-15)


# The real heads


@pytest.mark.parametrize("name", ["james", "status"])
def test_real_heads_come_back(shared_data: Path, name: str) -> None:
    avatar = load_avatar(shared_data / "avatars" / name)
    head = io.read(shared_data / "heads" / f"{name}.ply")
    torch.testing.assert_close(avatar.gaussians.means, head.means, rtol=0, atol=1e-6)
    torch.testing.assert_close(avatar.gaussians.log_scales, head.log_scales, rtol=0, atol=1e-5)
    assert torch.equal(avatar.gaussians.sh, head.sh)
    assert torch.equal(avatar.gaussians.opacity_logits, head.opacity_logits)
    found = torch.nn.functional.normalize(avatar.gaussians.quats.double(), dim=1)
    wanted = torch.nn.functional.normalize(head.quats.double(), dim=1)
    apart = torch.minimum((found - wanted).norm(dim=1), (found + wanted).norm(dim=1))
    # The mesh is stored as float32, which turns the smallest triangles by as much.
    assert torch.rad2deg(4 * torch.asin(apart / 2)).max() < 1.1e-4


def test_real_avatars_morph_as_their_plain_heads(shared_data: Path) -> None:
    heads = [shared_data / "heads" / f"{name}.ply" for name in ("james", "status")]
    flow = make_flow("node", 3)
    landmarks = [shared_data / "heads" / f"{head.stem}.landmarks.json" for head in heads]
    fit(flow, *(Landmarks.read(path) for path in landmarks), FitConfig(steps=2))
    plain = [io.read(head) for head in heads]
    baked_heads = [load_avatar(shared_data / "avatars" / head.stem).gaussians for head in heads]
    some = torch.arange(0, 20018, 40)
    wanted, found = (
        Morph(source.select(some), target.select(some), flow).at(0.5)
        for source, target in (plain, baked_heads)
    )
    torch.testing.assert_close(found.means, wanted.means, rtol=0, atol=1e-6)
    torch.testing.assert_close(found.log_scales, wanted.log_scales, rtol=0, atol=1e-5)
    torch.testing.assert_close(found.opacity_logits, wanted.opacity_logits)
