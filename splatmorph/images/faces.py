"""The landmarks of a face in a picture; needs the extra ``faces`` and a model file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from splatmorph.errors import LandmarkError
from splatmorph.images.picture import Picture
from splatmorph.landmarks import Landmarks
from splatmorph.registration.face_network import find_model, load_network


def detect_face(picture: Picture, model: str | Path | None = None) -> Landmarks:
    """The 478 landmarks of the clearest face in a picture, named ``face_0`` … ``face_477``.

    ``model`` is a ``face_landmarker.task``; see :func:`find_model` for where it is looked for.

    Raises:
        ReadError: the model is missing, or no such model.
        MissingExtraError: OpenCV is not installed.
        LandmarkError: no face is found.
    """
    network = load_network(find_model(model))
    found = network.find(np.ascontiguousarray(picture.with_channels(3).eight_bit()))
    if found is None:
        raise LandmarkError("no face is found in the picture: give its landmarks in a file")
    points = picture.canvas.to_world(torch.from_numpy(found.points[:, :2]))
    return Landmarks(points, tuple(f"face_{i}" for i in range(len(points))))
