"""What the tests of the picker share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from renderer import Camera, orbit
from splatmorph.landmarks import Landmarks
from splatmorph.view.pick import Desk

ASSETS = Path(__file__).parents[2] / "assets"
STRAIGHT = [
    "nose_tip",
    "glabella",
    "forehead",
    "cheek_left",
    "cheek_right",
    "mouth_corner_left",
    "mouth_corner_right",
    "nasion",
]
"""Seen from the front on skin that hides nothing; the others are clicked from two sides."""
ASIDE = ["eye_inner_left", "eye_inner_right", "nose_wing_left", "nose_wing_right"]
SIZE = 480
MARKS = ["nose_tip", "glabella", "forehead", "cheek_left", "cheek_right", "mouth_corner_left"]
"""Marks that the skin shows from the front on both of the pair, not under hair or lashes."""


def told(camera: Camera) -> dict:
    """A camera as the page sends it."""
    return {
        "rows": camera.viewmat[:3, :3].tolist(),
        "shift": camera.viewmat[:3, 3].tolist(),
        "focal": camera.K[0, 0],
        "middle": camera.K[:2, 2].tolist(),
        "width": camera.width,
        "height": camera.height,
    }


def camera_of(desk: Desk, side: int, azimuth: float = 0.0) -> Camera:
    return orbit(desk.sides[side].bounds, [azimuth], width=SIZE, height=SIZE)[0]


def pixel(camera: Camera, point: torch.Tensor) -> tuple[float, float]:
    x, y, z = camera.viewmat[:3, :3] @ point.numpy() + camera.viewmat[:3, 3]
    return camera.K[0, 0] * x / z + camera.K[0, 2], camera.K[1, 1] * y / z + camera.K[1, 2]


def click(desk: Desk, side: int, point: torch.Tensor, row: int | None = None, azimuth=0.0) -> dict:
    cameras = [camera_of(desk, end, azimuth) for end in (0, 1)]
    x, y = pixel(cameras[side], point)
    asked = {"leg": 0, "side": side, "row": row, "x": x, "y": y, "cameras": [*map(told, cameras)]}
    return desk.answer("pick", asked)


def pick_pair(desk: Desk, truth: tuple[Landmarks, Landmarks], name: str) -> int:
    source, target = (side.points[side.names.index(name)] for side in truth)
    row = click(desk, 0, source)["selected"]
    click(desk, 1, target, row)
    return row


def off(desk: Desk, row: int, side: int, point: torch.Tensor) -> float:
    place = desk.book.row(row).places[side]
    return float(np.linalg.norm(np.array(place.point) - point.numpy()))
