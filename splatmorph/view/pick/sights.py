"""Sight lines: where a click meets a splat's surface, and where two of them cross."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from renderer import Bounds, Camera
from splatmorph.rendering import rasterize
from splatmorph.view.pick.book import Point, Ray

Array = NDArray[np.float64]

SHARES = (0.1, 0.3, 0.5)
"""Of a pixel's light gathered from the front, at which depth is taken; the middle one is the
surface, the others tell how thick it is."""
FAINT = 0.3
"""Alpha below which nothing is there to be clicked."""
FRONT = 1.2
"""Radii before the center where the object begins; what is nearer floats."""
REACH = 4.0
"""Standard deviations within which a splat can be seen on a sight line."""
APART = 10.0
"""Degrees between two sight lines from which they are triangulated."""


@dataclass(frozen=True)
class Seen:
    """A surface point on a sight line."""

    point: Point
    ray: Ray
    spread: float
    """How far apart the depths of the outer ``SHARES`` are, world units: much means see-through."""


def ray_of(camera: Camera, x: float, y: float) -> Ray:
    """The sight line through pixel (x, y)."""
    K, R = camera.K, camera.viewmat[:3, :3]
    along = np.array([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], 1.0]) @ R
    along /= np.linalg.norm(along)
    return Ray(tuple(camera.position.tolist()), tuple(along.tolist()))


def near_of(camera: Camera, bounds: Bounds) -> float | None:
    """The depth before which everything floats in front of the object; None inside of it."""
    distance = float(np.linalg.norm(camera.position - bounds.center))
    near = distance - FRONT * bounds.radius
    return near if near > 0 else None


def surface(
    arrays: Sequence[NDArray[np.float32]], bounds: Bounds, camera: Camera, x: float, y: float
) -> Seen | None:
    """Where the sight line through pixel (x, y) meets the splat; None where nothing is."""
    index = _along(arrays, camera, x, y)
    if not len(index):
        return None
    means, quats, scales, opacities, sh = (array[index] for array in arrays)
    K = camera.K.copy()
    K[:2, 2] += 0.5 - np.array([x, y])
    depths = []
    for share in SHARES:
        _, alpha, depth = rasterize(
            means,
            quats,
            scales,
            opacities,
            sh,
            camera.viewmat,
            K,
            1,
            1,
            near=near_of(camera, bounds),
            depth="surface",
            surface_share=share,
        )
        depths.append(float(depth[0, 0]))
    if alpha[0, 0] < FAINT or min(depths) <= 0:
        return None
    ray = ray_of(camera, x, y)
    R, shift = camera.viewmat[:3, :3], camera.viewmat[:3, 3]
    seen = np.array([(x - camera.K[0, 2]) / K[0, 0], (y - camera.K[1, 2]) / K[1, 1], 1.0])
    point = (seen * depths[1] - shift) @ R
    return Seen(tuple(point.tolist()), ray, depths[2] - depths[0])


def _along(
    arrays: Sequence[NDArray[np.float32]], camera: Camera, x: float, y: float
) -> NDArray[np.intp]:
    """Indices of the splats that can show in one pixel."""
    means, _, scales, *_ = arrays
    R, shift = camera.viewmat[:3, :3].astype(np.float32), camera.viewmat[:3, 3].astype(np.float32)
    right, down, ahead = (means @ row + s for row, s in zip(R, shift, strict=True))
    focal = np.float32(camera.K[0, 0])
    dx, dy = np.float32(x - camera.K[0, 2]), np.float32(y - camera.K[1, 2])
    # In units of the depth: no division, and what is behind the camera is left out.
    off_x, off_y = focal * right - dx * ahead, focal * down - dy * ahead
    # Twice the size: a slanted sight line sees a splat longer than it is.
    reach = 2 * REACH * focal * scales.max(1) + 3 * ahead
    return np.flatnonzero((ahead > 0) & (off_x * off_x + off_y * off_y < reach * reach))


def crossing(rays: Sequence[Ray]) -> tuple[Point, float]:
    """The point closest to all rays (least squares), and the root mean square distance to them."""
    origins = np.array([ray.origin for ray in rays])
    directions = np.array([ray.direction for ray in rays])
    across = np.eye(3) - directions[:, :, None] * directions[:, None]
    point = np.linalg.solve(across.sum(0), (across @ origins[..., None]).sum(0)[:, 0])
    missed = (across @ (point - origins)[..., None])[..., 0]
    return tuple(point.tolist()), float(np.sqrt((missed**2).sum(1).mean()))


def stand_apart(ray: Ray, others: Sequence[Ray]) -> bool:
    """Whether ``ray`` comes from another side than each of ``others``."""
    cosines = [abs(float(np.dot(ray.direction, other.direction))) for other in others]
    return bool(others) and max(cosines) < np.cos(np.radians(APART))
