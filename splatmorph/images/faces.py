"""Face landmarks by MediaPipe's detector; needs the extra ``faces`` and a model file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from splatmorph.errors import LandmarkError, MissingExtraError, ReadError
from splatmorph.images.picture import Picture
from splatmorph.landmarks import Landmarks

MODEL_PAGE = "https://ai.google.dev/edge/mediapipe/solutions/vision/face_landmarker"


def detect_face(picture: Picture, model: str | Path) -> Landmarks:
    """The 478 landmarks of the one face in a picture, named ``face_0`` … ``face_477``.

    ``model`` is the ``face_landmarker.task`` that its makers publish (``MODEL_PAGE``); it is
    read from disk, nothing is fetched.

    Raises:
        ReadError: the model is missing, or no such model.
        MissingExtraError: mediapipe is not installed.
        LandmarkError: no face is found.
    """
    model = Path(model)
    if not model.is_file():
        raise ReadError(f"{model} is not there: fetch face_landmarker.task from {MODEL_PAGE}")
    try:
        import mediapipe
        from mediapipe.tasks.python.vision import FaceLandmarker
    except ImportError as error:
        raise MissingExtraError("mediapipe", "faces", "finding faces") from error
    try:
        detector = FaceLandmarker.create_from_model_path(str(model))
    except (RuntimeError, ValueError, OSError) as error:
        raise ReadError(f"{model} is no face landmarker model: {_first_line(error)}") from error
    pixels = np.ascontiguousarray(picture.with_channels(3).eight_bit())
    with detector:
        found = detector.detect(
            mediapipe.Image(image_format=mediapipe.ImageFormat.SRGB, data=pixels)
        ).face_landmarks
    if not found:
        raise LandmarkError("no face is found in the picture: give its landmarks in a file")
    canvas = picture.canvas
    fractions = torch.tensor([[point.x, point.y] for point in found[0]], dtype=torch.float64)
    points = canvas.to_world(fractions * torch.tensor([canvas.width, canvas.height]))
    return Landmarks(points, tuple(f"face_{i}" for i in range(len(points))))


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
