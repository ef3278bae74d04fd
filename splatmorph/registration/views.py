"""Pictures of a splat from all round: what registration sees of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from renderer import look_at
from renderer.rasterize import Depth
from splatmorph.gaussians import Gaussians
from splatmorph.rendering import Colour, rasterize, renderer_arrays

Array = NDArray[np.float64]
Picture = NDArray[np.float32]

MATCHED: Depth = "expected"
"""The depth by which two splats are matched, though it lies deeper than the surface: with that of
the surface james and status, faces unseen, are matched 12.4 mm off instead of 7.1."""
FOV = 24.0
"""Degrees: long enough a lens that a nose hides little."""
NEAR = 1e-3
"""Nearest depth that is drawn, of the camera's distance."""


@dataclass(frozen=True)
class Cameras:
    """c square cameras with one lens."""

    viewmats: Array
    """(c, 4, 4) world → camera, OpenCV axes."""
    focal: float
    """Pixels; the principal point is the middle."""
    side: int
    """Pixels."""
    near: float
    """World units."""

    def __len__(self) -> int:
        return len(self.viewmats)

    @property
    def K(self) -> Array:
        """(3, 3) camera → pixels."""
        middle = self.side / 2
        return np.array([[self.focal, 0, middle], [0, self.focal, middle], [0, 0, 1]])

    def of_camera(self, number: int, points: Array) -> Array:
        """World points (n, 3) in the axes of one camera."""
        viewmat = self.viewmats[number]
        return np.asarray(points @ viewmat[:3, :3].T + viewmat[:3, 3])

    @property
    def positions(self) -> Array:
        """(c, 3) where the cameras are."""
        R, t = self.viewmats[:, :3, :3], self.viewmats[:, :3, 3]
        return np.asarray(-np.einsum("cji,cj->ci", R, t))

    def to_world(self, number: int, seen: Array) -> Array:
        """Points (n, 3) in the axes of one camera, in the world."""
        viewmat = self.viewmats[number]
        return np.asarray((seen - viewmat[:3, 3]) @ viewmat[:3, :3])

    def rays(self, number: int, pixels: Array) -> Array:
        """Unit vectors (n, 3) from one camera through pixels (n, 2), world axes."""
        seen = np.c_[(pixels - self.side / 2) / self.focal, np.ones(len(pixels))]
        rays = seen @ self.viewmats[number, :3, :3]
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def pixels(self, seen: Array) -> Array:
        """Camera points (n, 3) as (n, 2) pixels."""
        return np.asarray(seen[:, :2] / seen[:, 2:] * self.focal + self.side / 2)


@dataclass(frozen=True)
class Pictures:
    """What c cameras see: (c, side, side) each."""

    rgb: Picture
    """(c, side, side, 3) premultiplied."""
    alpha: Picture
    depth: Picture
    """World units along the axis; where nothing is, 0."""


def spiral(count: int, *, belt: float = 1.0) -> Array:
    """(count, 3) unit vectors, evenly over the sphere; ``belt`` < 1 leaves out the poles of y."""
    step = np.arange(count) + 0.5
    height = np.arccos((1 - 2 * step / count) * belt)
    angle = math.pi * (1 + 5**0.5) * step
    return np.stack(
        [np.cos(angle) * np.sin(height), np.cos(height), np.sin(angle) * np.sin(height)], 1
    )


def looking(
    center: Array, directions: Array, ups: Array, radius: float, side: int, fov: float = FOV
) -> Cameras:
    """Cameras that keep a ball of ``radius`` round ``center`` (3,) in view, world units.

    ``directions`` (c, 3) point from the center to the cameras, ``ups`` (c, 3) to the top.
    """
    half = math.radians(fov / 2)
    distance = radius / math.sin(half)
    viewmats = [
        look_at(center + distance * direction, center, up)
        for direction, up in zip(directions, ups, strict=True)
    ]
    return Cameras(np.stack(viewmats), side / 2 / math.tan(half), side, NEAR * distance)


def around(center: Array, radius: float, count: int, side: int, *, belt: float = 1.0) -> Cameras:
    """``count`` cameras all round a ball, y up."""
    directions = spiral(count, belt=belt)
    ups = np.where(np.abs(directions[:, 1:2]) < 0.95, [[0.0, 1, 0]], [[0.0, 0, 1]])
    return looking(center, directions, ups, radius, side)


def photograph(
    gaussians: Gaussians,
    cameras: Cameras,
    *,
    background: Colour | None = None,
    near: float | None = None,
    depth: Depth = "surface",
) -> Pictures:
    """Render a splat from every camera; ``near`` in world units, ``depth`` as the renderer's."""
    K = np.repeat(cameras.K[None], len(cameras), 0)
    arrays = renderer_arrays(gaussians)
    side = cameras.side
    near = max(near or 0.0, cameras.near)
    return Pictures(
        *rasterize(
            *arrays,
            cameras.viewmats,
            K,
            side,
            side,
            near=near,
            background=background,
            depth=depth,
        )
    )
