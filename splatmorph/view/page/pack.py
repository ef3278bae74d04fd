"""The page's payload: splats at rest, their motion leg by leg, tables of opacity."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from renderer import Camera
from splatmorph.gaussians import Gaussians
from splatmorph.morph.agreement.fade import DENSEST_STACK
from splatmorph.morph.ramps import RAMPS
from splatmorph.rendering import orbit
from splatmorph.view.page.coding import Table
from splatmorph.view.page.leg import Leg
from splatmorph.view.page.palette import Palette
from splatmorph.view.scene import Scene

PICTURE_HEIGHT = 1080
"""Pixels of the picture in which the error of a move is counted."""
LOG_SCALE_SPAN = 12.0
"""Natural log of the largest scale over the smallest that is told from nothing."""
RAMP_STEPS = 65
GROWTH_STEP = 2.0**-13
"""Of the natural log of the factor by which a ramp scales a splat: ±4 in 16 bits."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Packed:
    """What the page is told, beside its texts."""

    tables: Mapping[str, Table]
    facts: Mapping[str, object]
    """JSON beside the tables: legs, ranges, the first camera."""
    knots: int
    """Of the leg that needs most; 0 where nothing moves."""
    error_px: float
    """The largest distance between a stored path and the flow's, in a 1080-pixel picture."""


def first_camera(scene: Scene, up: str, size: int = PICTURE_HEIGHT) -> Camera:
    """Where the page looks from at first, for a square picture of ``size`` pixels."""
    return orbit(scene.bounds(), [0.0], up=up, width=size, height=size)[0]


def pack(scene: Scene, kept: Sequence[torch.Tensor], up: str) -> Packed:
    """Pack those splats of ``scene`` that are ``kept``, by index, and all that moves them."""
    camera = first_camera(scene, up)
    center = scene.bounds().center
    distance = float(np.linalg.norm(camera.position - center))
    pixel = distance / float(camera.K[1, 1])
    right, down, forward = camera.viewmat[:3, :3]

    splats = [one.select(index) for one, index in zip(scene.splats, kept, strict=True)]
    legs = [
        Leg(one, place, *kept[i : i + 2])
        for i, (one, place) in enumerate(zip(scene.legs, scene.places, strict=True))
    ]
    whole = reduce(Gaussians.union, splats)
    palette = Palette.of([whole.sh, *(leg.others for leg in legs if leg.agrees)])
    still, ranges = _at_rest(whole, palette)
    tables = {**still, **_ramp_tables()}
    told: list[dict[str, Any]] = []
    for i, leg in enumerate(legs):
        own, facts = leg.packed(pixel, palette)
        tables |= {f"{name}{i}": table for name, table in own.items()}
        told.append(facts)
    facts = {
        **ranges,
        "legs": told,
        "densest": DENSEST_STACK,
        "rampNames": list(RAMPS),
        "rampSteps": RAMP_STEPS,
        "growthStep": GROWTH_STEP,
        "camera": {
            "center": center.tolist(),
            "right": right.tolist(),
            "up": (-down).tolist(),
            "back": (-forward).tolist(),
            "distance": distance,
            "azimuth": 0.0,
            "elevation": 0.0,
            "fov": 2 * math.atan(camera.height / 2 / float(camera.K[1, 1])),
            "near": min(0.01, 0.01 * distance),
        },
    }
    knots = max((len(leg["knots"]) for leg in told), default=0)
    return Packed(tables, facts, knots, max((leg["error"] for leg in told), default=0.0))


def _at_rest(splats: Gaussians, palette: Palette) -> tuple[dict[str, Table], dict[str, object]]:
    log_scales = splats.log_scales.double().numpy(force=True)
    top = float(log_scales.max())
    low = max(float(log_scales.min()), top - LOG_SCALE_SPAN)
    share = np.clip((log_scales - low) / max(top - low, 1e-6), 0, 1)
    sizes = np.rint(share * [2047, 2047, 1023]).astype(np.int16)
    # Opacities as square roots: most are small, and small ones need the finer steps.
    roots = np.sqrt(splats.opacities.double().numpy(force=True))
    opacities = np.rint(255 * roots).astype(np.uint8)
    tables = {
        "centers": Table(splats.means.float().numpy(force=True)),
        "colours": Table(np.column_stack([palette.colours(splats.sh), opacities])),
        "rotations": Table(_packed_rotations(splats.quats.double().numpy(force=True))),
        # A splat is as large along one axis as along the next more often than as its neighbour.
        "sizes": Table(sizes, delta=False, stride=1, times=1),
        "shades": Table(palette.shades(splats.sh)),
    }
    ranges = {
        "sizeRange": [low, top],
        "colourRange": [palette.low, palette.high],
        "shadeScale": palette.shade_step,
    }
    return tables, ranges


def _packed_rotations(quats: Array) -> NDArray[np.uint32]:
    """Quaternions as the place of their largest component and the other three in 10 bits each."""
    quats = quats / np.linalg.norm(quats, axis=1, keepdims=True).clip(1e-30)
    place = np.abs(quats).argmax(axis=1)
    rows = np.arange(len(quats))
    quats = quats * np.where(quats[rows, place] < 0, -1, 1)[:, None]
    others = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[place]
    small = quats[rows[:, None], others] * math.sqrt(2)
    steps = np.rint(511 * (np.clip(small, -1, 1) + 1)).astype(np.uint32)
    return np.asarray(
        steps[:, 0] | steps[:, 1] << 10 | steps[:, 2] << 20 | place.astype(np.uint32) << 30
    )[:, None]


def _ramp_tables() -> dict[str, Table]:
    """What each ramp makes of the 256 stored opacities at each weight: (ramps · RAMP_STEPS, 256).

    ``fades``: the opacity, in 65535ths; ``growths``: the change of log scale, in GROWTH_STEPs.
    """
    stored = (torch.arange(256, dtype=torch.float64) / 255).square()
    some = Gaussians(
        torch.zeros(256, 3),
        torch.zeros(256, 4),
        torch.zeros(256, 3, dtype=torch.float64),
        stored.clamp(1e-12, 1 - 1e-12).logit(),
        torch.zeros(256, 1, 3),
    )
    fades = np.zeros((len(RAMPS), RAMP_STEPS, 256))
    growths = np.zeros_like(fades)
    for i, ramp in enumerate(RAMPS.values()):
        for k, weight in enumerate(np.linspace(0, 1, RAMP_STEPS)[1:-1], start=1):
            faded = ramp(some, float(weight))
            fades[i, k], growths[i, k] = faded.opacities, faded.log_scales[:, 0]
    growths[:, 0] = growths[:, 1]
    fades[:, -1] = stored
    fades[:, :, 0] = 0
    rounded = np.rint(growths / GROWTH_STEP).clip(-32767, 32767)
    return {
        "fades": Table(np.rint(65535 * fades).astype(np.uint16).reshape(-1, 256)),
        "growths": Table(rounded.astype(np.int16).reshape(-1, 256)),
    }
