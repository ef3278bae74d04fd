"""Avatars carried by a mesh file in place of FLAME parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic_flame
import torch
from mesh_avatars import mesh_avatar

from splatmorph.avatars import load_avatar, pose_warnings, track_of
from splatmorph.avatars.flame import Flame
from splatmorph.errors import OptionError, ReadError


def test_meshes_posed_apart_are_told(tmp_path: Path, flame: Flame) -> None:
    open_mouth = synthetic_flame.model()["v_template"].copy()
    open_mouth[:, 1] -= 0.02 * (open_mouth[:, 1] < -0.036)
    resting = load_avatar(mesh_avatar(tmp_path / "resting"))
    opened = load_avatar(mesh_avatar(tmp_path / "opened", mesh_verts=open_mouth))
    (line,) = pose_warnings(resting, opened)
    assert "mouths by 2" in line
    (line,) = pose_warnings(resting, resting)
    assert "one and the same" in line


@pytest.mark.parametrize("extension", [".obj", ".ply", ".npy"])
def test_a_mesh_carries_the_avatar(tmp_path: Path, extension: str) -> None:
    import trimesh

    model = synthetic_flame.model()
    wanted = load_avatar(mesh_avatar(tmp_path / "a"))
    alone = mesh_avatar(tmp_path / "b", mesh_verts=None, faces=None)
    mesh = tmp_path / f"head{extension}"
    if extension == ".npy":
        np.save(mesh, model["v_template"][None].astype(np.float32))
        np.save(tmp_path / "faces.npy", model["f"])
    else:
        trimesh.Trimesh(model["v_template"], model["f"], process=False).export(mesh)
    found = load_avatar(alone, mesh=mesh)
    torch.testing.assert_close(found.gaussians.means, wanted.gaussians.means, rtol=0, atol=1e-6)
    assert found.posed == "as its mesh"
    assert not found.is_canonical


def test_an_obj_with_texture_seams_keeps_its_vertices(tmp_path: Path) -> None:
    model = synthetic_flame.model()
    lines = [f"v {x} {y} {z}" for x, y, z in model["v_template"]]
    lines += [f"vt {i / 3} {i / 7}" for i in range(3)]
    lines += [f"f {a}/{a % 3 + 1} {b}/{b % 2 + 1} {c}/1" for a, b, c in model["f"].astype(int) + 1]
    (tmp_path / "head.obj").write_text("\n".join(lines) + "\n")
    found = load_avatar(mesh_avatar(tmp_path / "a"), mesh=tmp_path / "head.obj")
    np.testing.assert_allclose(found.vertices, model["v_template"], atol=1e-12)
    np.testing.assert_array_equal(found.rig.faces, model["f"])


def test_a_mesh_with_teeth_may_lack_their_faces(tmp_path: Path, flame: Flame) -> None:
    vertices = flame.template.numpy()
    folder = mesh_avatar(tmp_path / "a", binding=[0, 10143], mesh_verts=vertices)
    avatar = load_avatar(folder)
    torch.testing.assert_close(avatar.rig.faces, flame.faces)


def test_faces_may_come_from_flame(tmp_path: Path, flame_folder: Path) -> None:
    folder = mesh_avatar(tmp_path / "a", faces=None)
    with pytest.raises(ReadError, match=r"vertices but no faces.*`flame`"):
        load_avatar(folder)
    found = load_avatar(folder, flame=flame_folder)
    np.testing.assert_array_equal(found.rig.faces, synthetic_flame.model()["f"])


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"mesh_verts": np.zeros((5000, 3))}, r"vertices of shape \(5000, 3\), expected \(5023"),
        ({"mesh_verts": np.full((5023, 3), np.inf)}, "NaN or infinite vertices"),
        ({"mesh_verts": np.array([None])}, "no whole .npy of numbers"),
        ({"mesh_verts": np.array(["a"])}, "expected numbers of a mesh"),
        ({"faces": np.zeros((9975, 3), int)}, r"faces of shape \(9975, 3\)"),
        ({"faces": np.full((9976, 3), 5023)}, "up to vertex 5023"),
        ({"mesh_verts": None}, r"neither flame_param\.npz nor mesh_verts\.npy"),
    ],
)
def test_wrong_meshes(tmp_path: Path, files: dict[str, Any], words: str) -> None:
    with pytest.raises(ReadError, match=words):
        load_avatar(mesh_avatar(tmp_path / "a", **files))


def test_wrong_mesh_files(tmp_path: Path) -> None:
    folder = mesh_avatar(tmp_path / "a")
    with pytest.raises(ReadError, match="does not exist"):
        load_avatar(folder, mesh=tmp_path / "absent.obj")
    (tmp_path / "broken.ply").write_text("no mesh at all")
    with pytest.raises(ReadError, match="no whole PLY file"):
        load_avatar(folder, mesh=tmp_path / "broken.ply")


def test_a_mesh_has_one_pose(tmp_path: Path, anna: Path) -> None:
    folder = mesh_avatar(tmp_path / "a")
    for arguments in ({"frame": 0}, {"pose": anna}):
        with pytest.raises(OptionError, match="can't take another pose"):
            load_avatar(folder, **arguments)
    with pytest.raises(ReadError, match=r"no flame_param\.npz, so it has no pose to give"):
        track_of(folder)
