"""What the tests of the picker share."""

from __future__ import annotations

from pathlib import Path

from renderer import Camera

ASSETS = Path(__file__).parents[2] / "assets"


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
