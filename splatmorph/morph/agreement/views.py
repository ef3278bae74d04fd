"""Views: splats seen from all round, and what each of them adds to the pictures.

A picture is Σᵢ wᵢₚ cᵢ over the splats i of colour cᵢ, with wᵢₚ the share of splat i in pixel p.
What pictures say is brought back to the splats by the same shares, xᵢ = Σₚ wᵢₚ xₚ / Σₚ wᵢₚ: each
pixel counts as much as the splat is seen in it, and each splat reads at its own size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from renderer import Bounds, Camera
from splatmorph.rendering import gather, orbit, rasterize

Arrays = tuple[Any, Any, Any, Any, Any]
"""means, quats, scales, opacities and sh, as ``renderer`` takes them."""

COUNT = 28
"""Directions, even over the sphere."""

SIZE = 256
"""Pixels a side."""

GOLDEN = math.degrees(math.pi * (3 - math.sqrt(5)))
"""Degrees from one direction to the next."""

HIGHEST = 80.0
"""Degrees of elevation that no direction exceeds."""


@dataclass(frozen=True)
class Picture:
    """What splats look like in one view."""

    rgb: Tensor
    """(3, h, w), not multiplied by alpha."""
    alpha: Tensor
    """(h, w)"""
    depth: Tensor
    """(h, w) world units."""


class View:
    """One camera."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera

    def picture(self, arrays: Arrays) -> Picture:
        """What it shows of a splat's arrays."""
        camera = self.camera
        rgb, alpha, depth = map(
            torch.from_numpy,
            rasterize(*arrays, camera.viewmat, camera.K, camera.width, camera.height),
        )
        straight = rgb.permute(2, 0, 1) / alpha.clamp_min(1e-4)
        return Picture(straight, alpha, depth)

    def gather(self, arrays: Arrays, values: Sequence[Tensor]) -> Tensor:
        """Σₚ wᵢₚ xₚ of k pictures (h, w): (n, k)."""
        stacked = torch.stack(list(values), -1).float().numpy()
        return torch.from_numpy(gather(*arrays[:4], self.camera.viewmat, self.camera.K, stacked))


def views_of(around: Bounds, *, count: int = COUNT, size: int = SIZE) -> list[View]:
    """Views from all round."""
    heights = 1 - (2 * np.arange(count) + 1) / count
    elevations = np.clip(np.degrees(np.arcsin(heights)), -HIGHEST, HIGHEST)
    return [
        View(orbit(around, [k * GOLDEN], elevation=float(lift), width=size, height=size)[0])
        for k, lift in enumerate(elevations)
    ]


def blurred(pictures: Tensor, sigma: float) -> Tensor:
    """Pictures (k, h, w) blurred by a Gaussian of ``sigma`` pixels, 0 beyond their edges.

    A wide blur is made of a smaller picture.
    """
    if sigma == 0:
        return pictures
    shrink = 4 if sigma >= 8 else 1
    small = avg_pool2d(pictures, shrink, ceil_mode=True) if shrink > 1 else pictures
    reach = math.ceil(3 * sigma / shrink)
    taps = [math.exp(-0.5 * (k * shrink / sigma) ** 2) for k in range(reach + 1)]
    total = taps[0] + 2 * sum(taps[1:])
    for axis in (1, 2):
        length = small.shape[axis]
        summed = small * (taps[0] / total)
        for k in range(1, min(reach + 1, length)):
            share = taps[k] / total
            summed.narrow(axis, 0, length - k).add_(small.narrow(axis, k, length - k), alpha=share)
            summed.narrow(axis, k, length - k).add_(small.narrow(axis, 0, length - k), alpha=share)
        small = summed
    if shrink == 1:
        return small
    size = pictures.shape[1:]
    return interpolate(small[None], size=size, mode="bilinear", align_corners=False)[0]
