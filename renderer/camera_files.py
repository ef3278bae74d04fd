"""Cameras from files: NeRF and nerfstudio, Inria's cameras.json, COLMAP's text model.

All are read as pinholes; lens distortion is left out.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from renderer.cameras import Array, Camera
from renderer.errors import CameraFileError
from renderer.reference import rotations

LARGEST_FILE = 16 << 20
"""Bytes of a camera file."""
LARGEST_SIDE = 1 << 15
"""Pixels of a picture's side in a camera file."""

KNOWN = (
    "a transforms.json of NeRF or nerfstudio, a camera path of nerfstudio's viewer, Inria's "
    "cameras.json, or COLMAP's images.txt beside its cameras.txt"
)

COLMAP_MODELS = {
    "SIMPLE_PINHOLE": (0, 0, 1, 2),
    "SIMPLE_RADIAL": (0, 0, 1, 2),
    "RADIAL": (0, 0, 1, 2),
    "PINHOLE": (0, 1, 2, 3),
    "OPENCV": (0, 1, 2, 3),
    "FULL_OPENCV": (0, 1, 2, 3),
}
"""Where fx, fy, cx and cy stand among the parameters of COLMAP's models."""


def read_cameras(path: str | Path, *, size: tuple[int, int] | None = None) -> list[Camera]:
    """Cameras of a file or of a COLMAP folder, in the file's order; COLMAP's by picture name.

    Read are ``transforms.json`` of NeRF and nerfstudio (OpenGL camera → world matrices; values of
    a frame win over those of the file), the camera path that nerfstudio's viewer saves, Inria's
    ``cameras.json``, and COLMAP's text model (``images.txt`` beside ``cameras.txt``). ``size``
    (width, height) is needed where the file has none, as in NeRF's synthetic scenes, and resizes
    the cameras where it has one. Raises CameraFileError.
    """
    path = Path(path)
    if path.is_dir():
        path = _model_in(path)
    try:
        cameras = list(_cameras_of(path, size))
    except OSError as error:
        raise CameraFileError(f"{path}: can't be read: {error.strerror}") from error
    except CameraFileError:
        raise
    except Exception as error:  # files can hold anything, and numbers of any size
        raise CameraFileError(f"{path}: is not {KNOWN}: {_reason(error)}") from error
    if not cameras:
        raise CameraFileError(f"{path}: has no cameras; expected at least one")
    return [camera if size is None else camera.resized(*size) for camera in cameras]


def _cameras_of(path: Path, size: tuple[int, int] | None) -> Iterator[Camera]:
    if path.suffix.lower() == ".txt":
        return _of_colmap(path)
    content = json.loads(_text(path))
    if isinstance(content, list):
        return (_of_inria(entry) for entry in content)
    if "camera_path" in content:
        return (_of_key({**content, **key}, size) for key in content["camera_path"])
    return (_of_frame({**content, **frame}, size) for frame in content["frames"])


def _of_frame(frame: Mapping[str, Any], size: tuple[int, int] | None) -> Camera:
    """NeRF and nerfstudio: OpenGL camera → world."""
    if "FISHEYE" in str(frame.get("camera_model", "")).upper():
        raise ValueError("fisheye cameras are not supported, only pinholes")
    viewmat = _viewmat_of_opengl(np.array(frame["transform_matrix"], float))
    width, height = _size(frame.get("w"), frame.get("h"), size)
    if "fl_x" in frame:
        fx = float(frame["fl_x"])
        fy = float(frame.get("fl_y", fx))
    else:
        fx = fy = _focal(float(frame["camera_angle_x"]), width, "camera_angle_x")
    cx, cy = float(frame.get("cx", width / 2)), float(frame.get("cy", height / 2))
    return _pinhole(viewmat, (fx, fy, cx, cy), width, height)


def _of_key(key: Mapping[str, Any], size: tuple[int, int] | None) -> Camera:
    """nerfstudio's viewer: OpenGL camera → world row by row, fov up and down in degrees."""
    if key.get("camera_type", "perspective") != "perspective":
        raise ValueError(f"{key['camera_type']} cameras are not supported, only perspective ones")
    viewmat = _viewmat_of_opengl(np.array(key["camera_to_world"], float).reshape(-1, 4))
    width, height = _size(key.get("render_width"), key.get("render_height"), size)
    focal = _focal(math.radians(float(key["fov"])), height, "fov")
    return _pinhole(viewmat, (focal, focal, width / 2, height / 2), width, height)


def _of_inria(entry: Mapping[str, Any]) -> Camera:
    """Inria: OpenCV axes, the camera's place and its rotation camera → world."""
    to_world = np.eye(4)
    to_world[:3, :3] = entry["rotation"]
    to_world[:3, 3] = entry["position"]
    width, height = _size(entry["width"], entry["height"], None)
    inner = (float(entry["fx"]), float(entry["fy"]), width / 2, height / 2)
    return _pinhole(_inverse(to_world, "rotation"), inner, width, height)


def _of_colmap(path: Path) -> Iterator[Camera]:
    """COLMAP: rotation and shift world → camera, OpenCV axes; lenses in a file beside."""
    lenses = {}
    for words in map(str.split, _lines(path.with_name("cameras.txt"))):
        key, model, *numbers = words
        if model not in COLMAP_MODELS:
            raise ValueError(
                f"{model} cameras are not supported, expected {', '.join(COLMAP_MODELS)}"
            )
        width, height = _size(numbers[0], numbers[1], None)
        inner = tuple(float(numbers[2 + i]) for i in COLMAP_MODELS[model])
        lenses[key] = inner, width, height
    # Every second line lists the points that a picture shows, and may be empty.
    pictures = [line.split(maxsplit=9) for line in _lines(path, every=2)]
    for _, *pose, camera, _name in sorted(pictures, key=lambda words: words[9]):
        quat, shift = np.split(np.array(pose, float), [4])
        viewmat = np.eye(4)
        viewmat[:3, :3] = rotations(quat[None])[0]
        viewmat[:3, 3] = shift
        yield _pinhole(viewmat, *lenses[camera])


def _model_in(folder: Path) -> Path:
    for place in (folder, folder / "0", folder / "sparse" / "0", folder / "sparse"):
        if (place / "images.txt").is_file():
            return place / "images.txt"
        if (place / "images.bin").is_file():
            raise CameraFileError(
                f"{place}: is a binary model of COLMAP, expected its text: run  "
                f"colmap model_converter --output_type TXT  first"
            )
    raise CameraFileError(f"{folder}: is a folder without images.txt, expected {KNOWN}")


def _lines(path: Path, every: int = 1) -> list[str]:
    """Lines that are no comments; of ``every`` so many the first, counted from the first pose."""
    lines = [line for line in _text(path).splitlines() if not line.startswith("#")]
    return [line for line in lines[::every] if line.strip()]


def _text(path: Path) -> str:
    if path.exists() and not path.is_file():
        raise CameraFileError(f"{path}: is no file, expected {KNOWN}")
    if path.stat().st_size > LARGEST_FILE:
        raise CameraFileError(f"{path}: is larger than {LARGEST_FILE >> 20} MB")
    return path.read_text(encoding="utf-8")


def _viewmat_of_opengl(matrix: Array) -> Array:
    if matrix.shape not in {(3, 4), (4, 4)} or not np.isfinite(matrix).all():
        raise ValueError(f"its matrix has shape {matrix.shape}, expected finite 4x4")
    to_world = np.eye(4)
    to_world[: len(matrix)] = matrix
    # OpenGL's y and z axes are OpenCV's, turned round.
    to_world[:3, 1:3] *= -1
    return _inverse(to_world, "its matrix")


def _inverse(to_world: Array, what: str) -> Array:
    viewmat = np.asarray(np.linalg.inv(to_world), np.float64)
    if not np.isfinite(viewmat).all():
        raise ValueError(f"{what} can't be inverted")
    return viewmat


def _size(width: Any, height: Any, given: tuple[int, int] | None) -> tuple[int, int]:
    if width is None or height is None:
        if given is None:
            raise ValueError("no picture size (w, h) in the file: give one")
        return given
    sides = int(width), int(height)
    if not all(1 <= side <= LARGEST_SIDE for side in sides):
        raise ValueError(f"pictures of {width}x{height}, expected 1 to {LARGEST_SIDE} a side")
    return sides


def _focal(angle: float, side: int, what: str) -> float:
    if not 0 < angle < math.pi:
        raise ValueError(f"{what} is {angle:.3g} radians, expected between 0 and π")
    return side / 2 / math.tan(angle / 2)


def _pinhole(viewmat: Array, inner: ArrayLike, width: int, height: int) -> Camera:
    fx, fy, cx, cy = np.asarray(inner, np.float64)
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    if not (np.isfinite(K).all() and fx > 0 and fy > 0):
        raise ValueError(f"focal lengths {fx:.3g} and {fy:.3g}, expected finite and above 0")
    return Camera(viewmat, K, width, height)


def _reason(error: Exception) -> str:
    if isinstance(error, KeyError):
        return f"no {error}"
    if isinstance(error, RecursionError):
        return "it nests too deep"
    return next(iter(str(error).splitlines()), type(error).__name__)[:160]
