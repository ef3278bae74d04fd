"""Refinement: what two pictures still show apart half way, as further landmarks.

Landmarks hold a face; hair, ears and shoulders are where the flow happens to take them. Half way
both pictures are warped close to each other: there dense optical flow (OpenCV's DIS) can follow
what the one shows into the other, once neither is brighter than the other anywhere.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from splatmorph.images.canvas import Canvas
from splatmorph.images.correspond import Points, dense_motion
from splatmorph.images.picture import Picture
from splatmorph.images.warp import FlowWarp, PixelMap, sample
from splatmorph.landmarks import Landmarks

LONGEST = 384
"""Pixels of the longer side of the pictures in which motion is sought; all below is in these."""
EVEN = 16.0
"""Over which brightness and contrast are made even."""
CALM = 0.02
"""Contrast, of 1, that is not made stronger."""
RETURN = 1.5
"""Forward and backward motion must meet again within this."""
FAR = 16.0
"""More than this is another thing that looks alike."""
SMOOTH = 8.0
"""Over which motion is averaged: it is weak, and finer detail is the pictures' own."""
SURE = 0.4
"""The part of the motion around a point that must return for the point to be kept."""
ROOM = 20.0
"""Around a landmark that is there: nothing is added, it says all."""
STEP = 12
"""Between the points that are added."""


def refined(
    source: Picture, target: Picture, warp: FlowWarp, landmarks: tuple[Landmarks, Landmarks]
) -> tuple[Landmarks, Landmarks]:
    """The matched ``landmarks``, and points between them that optical flow brings together.

    Arguments:
        source, target: the pictures.
        warp: fitted to ``landmarks``.

    Raises:
        MissingExtraError: OpenCV is not installed.
    """
    scale = LONGEST / max(source.canvas.width, source.canvas.height)
    canvas = source.canvas.scaled(scale)
    ((where_source, where_target),) = warp.maps(canvas, [0.5])
    first, second = (
        _even(picture, where, canvas)
        for picture, where in ((source, where_source), (target, where_target))
    )
    forth, sure = _motion(first, second)
    p, q, names = landmarks[0].match(landmarks[1])
    held = canvas.to_pixels(warp.carry(p, 0.5)).numpy()
    across, down = (slice(STEP // 2, side, STEP) for side in (canvas.width, canvas.height))
    x, y = (a.ravel() for a in np.mgrid[across, down])
    at = np.stack([x, y], 1) + 0.5
    kept = (sure[y, x] > SURE) & (cKDTree(held).query(at)[0] > ROOM)
    middle, moved = (torch.from_numpy(a[kept]) for a in (at, forth[y, x]))
    more_p = warp.read(canvas.to_world(middle - moved / 2), [0.5])[0][0]
    more_q = warp.read(canvas.to_world(middle + moved / 2), [0.5])[1][0]
    names += tuple(f"motion_{i}" for i in range(len(middle)))
    ends = (torch.cat([p, more_p.to(p)]), torch.cat([q, more_q.to(q)]))
    return Landmarks(ends[0], names), Landmarks(ends[1], names)


def _even(picture: Picture, where: PixelMap, canvas: Canvas) -> Picture:
    """A picture read through a map, grey, of the same brightness and contrast everywhere."""
    planes = picture.with_channels(3).planes(canvas)
    own = Canvas(planes.shape[2], planes.shape[1])
    grey = sample(planes, own, where, canvas).mean(0).numpy()
    grey = grey - gaussian_filter(grey, EVEN)
    contrast = np.sqrt(gaussian_filter(grey**2, EVEN)) + CALM
    values = np.clip(0.5 + grey / (4 * contrast), 0, 1)
    return Picture((255 * values[..., None]).astype(np.uint8))


def _motion(first: Picture, second: Picture) -> tuple[Points, Points]:
    """The smoothed motion (h, w, 2) from one to the other, and how much of it returns (h, w)."""
    forth, back = dense_motion(first, second), dense_motion(second, first)
    y, x = np.mgrid[: forth.shape[0], : forth.shape[1]]
    place = [y + forth[..., 1], x + forth[..., 0]]
    returned = np.stack([map_coordinates(back[..., k], place, order=1) for k in (0, 1)], -1)
    apart = np.linalg.norm(forth + returned, axis=-1)
    sure = ((apart < RETURN) & (np.linalg.norm(forth, axis=-1) < FAR)).astype(float)
    around = gaussian_filter(sure, SMOOTH)
    mean = gaussian_filter(forth * sure[..., None], (SMOOTH, SMOOTH, 0))
    return mean / np.maximum(around, 1e-3)[..., None], around
