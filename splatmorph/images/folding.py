"""Where a warp turns the picture over."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from splatmorph.images.canvas import Canvas
from splatmorph.images.warp import Warp

SIDE = 256


@dataclass(frozen=True)
class Area:
    """What the warps to either end multiply small areas by; below 0 they are turned over."""

    least: float
    folded: float
    """Share of the picture that is turned over."""


def least_area(warp: Warp) -> Area:
    """By differences over 256 × 256 pixels, the worse of both whole ways, t = 1 and t = 0."""
    canvas = Canvas(SIDE, SIDE)
    (source, _), (_, target) = warp.maps(canvas, [1.0, 0.0])
    areas = []
    for way in (source, target):
        where = way.band(0, SIDE)
        right = (where[:-1, 1:] - where[:-1, :-1]) / canvas.pixel
        down = (where[1:, :-1] - where[:-1, :-1]) / canvas.pixel
        areas.append(right[..., 1] * down[..., 0] - right[..., 0] * down[..., 1])
    least = min(float(area.min()) for area in areas)
    folded = max(float((area <= 0).to(torch.float64).mean()) for area in areas)
    return Area(least, folded)
