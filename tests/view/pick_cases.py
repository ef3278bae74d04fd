"""What the tests of the picker share."""

from __future__ import annotations

from pathlib import Path

from renderer import Camera

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
