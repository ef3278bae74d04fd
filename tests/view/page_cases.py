"""What the tests of pages and their benchmark share."""

from __future__ import annotations

import numpy as np
from driven import Driven

from renderer import rasterize
from splatmorph.gaussians import Gaussians

GROUND = (0.1, 0.1, 0.12)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.square(a.astype(float) - b).mean()))


def our_picture(browser: Driven, splats: Gaussians) -> np.ndarray:
    """Our rasterizer's picture from where the page's camera stands."""
    view = browser.evaluate("splatmorph.view()")
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = view["rows"], view["shift"]
    (cx, cy), f = view["middle"], view["focal"]
    rgb, _, _ = rasterize(
        splats.means.numpy(),
        splats.quats.numpy(),
        splats.scales.numpy(),
        splats.opacities.numpy(),
        splats.sh.numpy(),
        viewmat,
        np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]]),
        view["width"],
        view["height"],
        background=GROUND,
    )
    return np.asarray(rgb).clip(0, 1)
