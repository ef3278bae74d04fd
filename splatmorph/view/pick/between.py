"""The morph between two inputs as it is at the moment, for the page to play."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from renderer import Camera
from splatmorph.images import FlowWarp, ImageMorph
from splatmorph.morph import Morph
from splatmorph.rendering import render
from splatmorph.view.page.coding import along_curve
from splatmorph.view.pick.guide import Guide
from splatmorph.view.pick.sides import PictureSide, SplatSide, jpeg, payload
from splatmorph.view.scene import Scene
from splatmorph.view.subject import Subject, thin

MOST_MOVING = 80_000
"""Splats of both sides together in a morph that plays while points are picked."""
LONGEST = 640
"""Pixels of the longer side of a picture between two."""


def moving(source: SplatSide, target: SplatSide, guide: Guide) -> Mapping[str, Any]:
    """The morph as the page draws it, in the place of the target."""
    morph = _morph(source, target, guide)
    subject = Subject(morph, source.name, target.name)
    halves = (morph.source, morph.target)
    orders = [torch.from_numpy(along_curve(half.means.double().numpy())) for half in halves]
    made = payload(Scene.of(subject), orders, target.up)
    frame = guide.frame
    rows = torch.cat([frame.scale * frame.rotation, frame.shift[:, None]], 1)
    made["legs"][0]["frame"] = {"knots": [0.0], "rows": [rows.tolist()]}
    return made


def still(source: SplatSide, target: SplatSide, guide: Guide, t: float, camera: Camera) -> bytes:
    """The morph at t as the rasterizer draws it, in the place of the target: a JPEG."""
    morph = _morph(source, target, guide)
    return jpeg(render(morph.at(t).moved(guide.frame), camera))


def plane(source: PictureSide, target: PictureSide, guide: Guide, t: float) -> bytes:
    """The picture between two at t, a JPEG."""
    assert guide.flow is not None
    canvas = target.picture.canvas
    shrink = min(1.0, LONGEST / max(canvas.width, canvas.height))
    small = canvas.scaled(shrink)
    pictures = (source.picture.with_channels(3), target.picture.with_channels(3))
    morph = ImageMorph(*pictures, FlowWarp(guide.flow, guide.frame), small)
    return jpeg(np.asarray(morph.at(t).rgb()))


def _morph(source: SplatSide, target: SplatSide, guide: Guide) -> Morph:
    assert guide.flow is not None
    a, b = (
        side.gaussians.select(thin(side.gaussians, MOST_MOVING // 2)) for side in (source, target)
    )
    return Morph(a, b, guide.flow, frame=guide.frame, blend="union", stay=True)
