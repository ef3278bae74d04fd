"""Two real faces with their landmarks (FRLL 001 and 002)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from splatmorph.fitting import FitConfig, fit
from splatmorph.flows import make_flow
from splatmorph.images import (
    Canvas,
    FlowWarp,
    ImageMorph,
    Picture,
    read_pair,
    read_points,
    with_anchors,
)
from splatmorph.images.faces import detect_face
from splatmorph.landmarks import Landmarks
from splatmorph.metrics import landmark_mse


@pytest.fixture
def faces(shared_data: Path) -> tuple[Picture, Picture]:
    """The two pictures."""
    return (
        Picture.read(shared_data / "faces2d" / "001_03.jpg"),
        Picture.read(shared_data / "faces2d" / "002_03.jpg"),
    )


@pytest.fixture(params=["template", "manual"])
def landmarks(
    request: pytest.FixtureRequest, shared_data: Path, faces: tuple[Picture, Picture]
) -> tuple[Landmarks, Landmarks]:
    """189 points of a template each, or the paper's 130 pairs, as they come."""
    folder = shared_data / "faces2d"
    a, b = (picture.canvas for picture in faces)
    if request.param == "template":
        return read_points(folder / "001_03.tem", a), read_points(folder / "002_03.tem", b)
    pair = read_pair(folder / "flowing_manual_landmarks_001_002.json", a, b)
    assert pair is not None
    return pair


def test_faces_meet_without_folding(
    faces: tuple[Picture, Picture], landmarks: tuple[Landmarks, Landmarks]
) -> None:
    flow = make_flow("node", dim=2)
    fit(flow, *with_anchors(*landmarks, canvases(faces), 2), FitConfig(smoothing=1e-4))
    # Over all given points, those that contradict each other by a pixel or two included.
    assert landmark_mse(flow, landmarks[0].points, landmarks[1].points) <= 1e-6
    canvas = Canvas(256, 256)
    source, target = next(FlowWarp(flow, tolerance=0.02).maps(canvas, [1.0]))
    assert float(areas(source.band(0, 256), canvas).min()) > 0
    source, target = next(FlowWarp(flow, tolerance=0.02).maps(canvas, [0.0]))
    assert float(areas(target.band(0, 256), canvas).min()) > 0


def canvases(faces: tuple[Picture, Picture]) -> tuple[Canvas, Canvas]:
    return faces[0].canvas, faces[1].canvas


def areas(where: torch.Tensor, canvas: Canvas) -> torch.Tensor:
    """Signed area of each pixel after the warp, in pixels: the determinant by differences."""
    right = (where[:-1, 1:] - where[:-1, :-1]) / canvas.pixel
    down = (where[1:, :-1] - where[:-1, :-1]) / canvas.pixel
    return right[..., 1] * down[..., 0] - right[..., 0] * down[..., 1]


def test_eyes_and_mouth_come_to_lie_on_each_other(
    faces: tuple[Picture, Picture], landmarks: tuple[Landmarks, Landmarks]
) -> None:
    flow = make_flow("node", dim=2)
    fit(flow, *with_anchors(*landmarks, canvases(faces), 2))
    canvas = Canvas(270, 270)
    source, target = (
        ImageMorph(*faces, FlowWarp(flow), canvas, blend=only).at(0.5).pixels.mean(2)
        for only in (lambda a, b, t: a, lambda a, b, t: b)
    )
    eyes, mouth = (slice(115, 140), slice(90, 180)), (slice(160, 182), slice(110, 160))
    for part in (eyes, mouth):
        likeness = np.corrcoef(source[part].ravel(), target[part].ravel())[0, 1]
        assert likeness > 0.8  # unwarped: 0.48 and 0.69


def test_a_face_is_found_as_its_template_says(
    faces: tuple[Picture, Picture], shared_data: Path
) -> None:
    pytest.importorskip("cv2")
    model = shared_data / "models" / "face_landmarker.task"
    if not model.is_file():
        pytest.skip("the face model is not here")
    found = detect_face(faces[0], model)
    canvas = faces[0].canvas
    template = read_points(shared_data / "faces2d" / "001_03.tem", canvas).points
    # The template begins with the pupils; the irises' centers are the network's 468 and 473.
    pupils = found.points[[468, 473]]
    assert float((pupils - template[:2]).norm(dim=1).max()) < 8 * canvas.pixel
