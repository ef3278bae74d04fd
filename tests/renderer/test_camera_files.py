"""Camera files: each kind says the same camera in its own words."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from renderer import Camera, CameraFileError, look_at, read_cameras

VIEWMAT = look_at([1.0, 0.4, 2.0], [0.1, 0.0, -0.2], [0, 1, 0])
TO_WORLD = np.linalg.inv(VIEWMAT)
OPENGL = TO_WORLD @ np.diag([1, -1, -1, 1.0])
FOCAL = 400.0


def pixels_of(camera, points):
    seen = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    projected = seen @ camera.K.T
    return projected[:, :2] / projected[:, 2:]


def in_transforms(folder):
    content = {"w": 640, "h": 480, "fl_x": FOCAL}
    content["frames"] = [{"transform_matrix": OPENGL.tolist()}]
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder / "transforms.json"


def in_a_camera_path(folder):
    fov = np.degrees(2 * np.arctan(240 / FOCAL))
    content = {"camera_type": "perspective", "render_width": 640, "render_height": 480}
    content["camera_path"] = [{"camera_to_world": OPENGL.ravel().tolist(), "fov": fov, "aspect": 1}]
    (folder / "camera_path.json").write_text(json.dumps(content))
    return folder / "camera_path.json"


def in_inrias_cameras(folder):
    camera = {"id": 0, "img_name": "a", "width": 640, "height": 480, "fx": FOCAL, "fy": FOCAL}
    camera |= {"position": TO_WORLD[:3, 3].tolist(), "rotation": TO_WORLD[:3, :3].tolist()}
    (folder / "cameras.json").write_text(json.dumps([camera]))
    return folder / "cameras.json"


def in_colmap(folder):
    x, y, z, w = Rotation.from_matrix(VIEWMAT[:3, :3]).as_quat()
    shift = " ".join(map(str, VIEWMAT[:3, 3]))
    (folder / "cameras.txt").write_text(f"# lenses\n7 SIMPLE_RADIAL 640 480 {FOCAL} 320 240 0.1\n")
    (folder / "images.txt").write_text(
        f"# poses\n2 {w} {x} {y} {z} {shift} 7 b c.jpg\n\n1 1 0 0 0 0 0 0 7 z.jpg\n1 2 -1\n"
    )
    return folder


@pytest.mark.parametrize("written", [in_transforms, in_a_camera_path, in_inrias_cameras, in_colmap])
def test_every_kind_says_the_same_camera(tmp_path, written):
    camera, *_ = read_cameras(written(tmp_path))
    assert isinstance(camera, Camera)
    np.testing.assert_allclose(camera.viewmat, VIEWMAT, atol=1e-12)
    np.testing.assert_allclose(camera.K, [[FOCAL, 0, 320], [0, FOCAL, 240], [0, 0, 1]])
    assert (camera.width, camera.height) == (640, 480)
    small, *_ = read_cameras(written(tmp_path), size=(320, 240))
    np.testing.assert_allclose(small.K[:2], camera.K[:2] / 2)


def test_colmaps_pictures_come_by_name(tmp_path):
    _, second = read_cameras(in_colmap(tmp_path))
    np.testing.assert_array_equal(second.viewmat, np.eye(4))
    assert len(read_cameras(tmp_path / "images.txt")) == 2


def test_bad_colmap_models_are_refused(tmp_path):
    with pytest.raises(CameraFileError, match=r"without images\.txt"):
        read_cameras(tmp_path)
    (tmp_path / "sparse" / "0").mkdir(parents=True)
    (tmp_path / "sparse" / "0" / "images.bin").touch()
    with pytest.raises(CameraFileError, match="model_converter"):
        read_cameras(tmp_path)
    in_colmap(tmp_path)
    (tmp_path / "cameras.txt").write_text("7 OPENCV_FISHEYE 640 480 1 1 1 1 0 0 0 0\n")
    with pytest.raises(CameraFileError, match="FISHEYE"):
        read_cameras(tmp_path)
    (tmp_path / "cameras.txt").unlink()
    with pytest.raises(CameraFileError, match="No such file"):
        read_cameras(tmp_path)


@pytest.mark.parametrize(
    ("content", "found"),
    [
        ({"camera_path": []}, "no cameras"),
        ({"camera_path": [{"fov": 40}]}, "camera_to_world"),
        ({"camera_type": "fisheye", "camera_path": [{}]}, "fisheye"),
        ([{"id": 1}], "rotation"),
        ([[1]], "Inria"),
    ],
)
def test_other_json_is_refused_with_what_is_read(tmp_path, content, found):
    (tmp_path / "x.json").write_text(json.dumps(content))
    with pytest.raises(CameraFileError, match=found):
        read_cameras(tmp_path / "x.json")


def transforms(tmp_path, **content):
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(content))
    return path


IDENTITY = np.eye(4).tolist()


def test_transforms_of_nerfstudio(tmp_path):
    path = transforms(
        tmp_path, w=80, h=60, fl_x=70, fl_y=71, cx=39, cy=31,
        frames=[{"transform_matrix": IDENTITY}, {"transform_matrix": IDENTITY[:3], "fl_x": 90}],
    )  # fmt: skip
    first, second = read_cameras(path)
    np.testing.assert_array_equal(first.K, [[70, 0, 39], [0, 71, 31], [0, 0, 1]])
    assert second.K[0, 0] == 90
    assert (first.width, first.height) == (80, 60)
    # An OpenGL camera at rest looks along -z with y up.
    (x, y), *_ = pixels_of(first, np.array([[0.1, 0.2, -1.0]]))
    assert x > 39
    assert y < 31


def test_transforms_of_nerf_need_a_size(tmp_path):
    path = transforms(tmp_path, camera_angle_x=1.0, frames=[{"transform_matrix": IDENTITY}])
    (camera,) = read_cameras(path, size=(100, 50))
    assert camera.K[0, 0] == pytest.approx(50 / np.tan(0.5))
    with pytest.raises(CameraFileError, match="size"):
        read_cameras(path)


def test_transforms_are_resized(tmp_path):
    path = transforms(tmp_path, w=80, h=60, fl_x=70, frames=[{"transform_matrix": IDENTITY}])
    (camera,) = read_cameras(path, size=(40, 30))
    np.testing.assert_allclose(camera.K, [[35, 0, 20], [0, 35, 15], [0, 0, 1]])


@pytest.mark.parametrize(
    ("content", "found"),
    [
        ({"frames": []}, "no cameras"),
        ({}, "frames"),
        ([], "no cameras"),
        ("no", "transforms.json"),
        ({"w": 8, "h": 8, "fl_x": 9, "frames": [{}]}, "transform_matrix"),
        ({"w": 8, "h": 8, "frames": [{"transform_matrix": IDENTITY}]}, "camera_angle_x"),
        ({"w": 8, "h": 8, "fl_x": 9, "frames": [{"transform_matrix": [[1]]}]}, "shape"),
        ({"w": 8, "h": 8, "fl_x": 9, "frames": [{"transform_matrix": [[0] * 4] * 4}]}, "Singular"),
        (
            {"camera_model": "OPENCV_FISHEYE", "frames": [{"transform_matrix": IDENTITY}]},
            "fisheye",
        ),
    ],
)
def test_bad_transforms_are_refused(tmp_path, content, found):
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(content))
    with pytest.raises(CameraFileError, match=found):
        read_cameras(path)


def test_missing_and_broken_files_are_refused(tmp_path):
    with pytest.raises(CameraFileError, match="No such file"):
        read_cameras(tmp_path / "none.json")
    (tmp_path / "text.json").write_text("not json")
    with pytest.raises(CameraFileError, match=r"text\.json"):
        read_cameras(tmp_path / "text.json")
