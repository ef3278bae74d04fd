"""Cameras: where the picture is taken from.

A camera looks along its +z, with x to the right and y down (OpenCV). ``viewmat`` takes world
points to camera points; ``K`` takes camera points to pixels; the center of the first pixel is
at (0.5, 0.5).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.errors import ArgumentError

Array = NDArray[np.float64]

FOV = 30.0
"""Default field of view, degrees: a portrait lens, so that noses keep their size."""
ENOUGH = 200_000
"""Splats that tell where an object is."""
MARGIN = 1.05
"""Room left around the object, as a factor on its radius."""

# The axes (right, up, front) of an object that stands upright under each convention.
UPRIGHT: Mapping[str, Array] = {
    "y": np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]], float),
    "-y": np.array([[-1, 0, 0], [0, -1, 0], [0, 0, 1]], float),
    "z": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], float),
    "-z": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float),
}


@dataclass(frozen=True)
class Camera:
    """A pinhole camera."""

    viewmat: Array
    """(4, 4) world → camera, OpenCV axes."""
    K: Array
    """(3, 3) camera → pixels."""
    width: int
    """Pixels."""
    height: int
    """Pixels."""

    @property
    def position(self) -> Array:
        """(3,) the camera's place in the world."""
        return np.asarray(-self.viewmat[:3, :3].T @ self.viewmat[:3, 3])

    def resized(self, width: int, height: int) -> Camera:
        """The same view on another raster: the shorter side keeps its field of view."""
        scale = min(width, height) / min(self.width, self.height)
        K = self.K.copy()
        K[:2, :2] *= scale
        K[0, 2] = width / 2 + (K[0, 2] - self.width / 2) * scale
        K[1, 2] = height / 2 + (K[1, 2] - self.height / 2) * scale
        return Camera(self.viewmat, K, width, height)


@dataclass(frozen=True)
class Bounds:
    """A sphere round the object, not round its floaters."""

    center: Array
    """(3,) world units."""
    radius: float
    """World units."""


def bounds_of(means: ArrayLike, opacities: ArrayLike, scales: ArrayLike) -> Bounds:
    """The sphere that holds the visible body of a splat.

    A splat weighs as much as it can cover (opacity times the product of its two largest
    scales, capped so that one huge haze can't outweigh the body). Far outliers are those
    beyond twice the distance that holds 80 % of the weight; they are dropped before the
    extent is taken, so a few floaters neither shift nor shrink the object. Where there are many
    splats, some ``ENOUGH`` of them, evenly strewn over their order, stand for all.

    means (n, 3), opacities (n,) in [0, 1], scales (n, 3), numpy or torch. Raises ArgumentError
    where nothing visible and finite is left.
    """
    whole = [np.asarray(a) for a in (means, opacities, scales)]
    step = max(1, len(whole[0]) // ENOUGH)
    points, alphas, sizes = (a[::step].astype(np.float64) for a in whole)
    sizes = np.sort(sizes, axis=1)
    with np.errstate(invalid="ignore", over="ignore"):
        weights = alphas * sizes[:, 1] * sizes[:, 2]
    seen = np.isfinite(points).all(1) & np.isfinite(weights) & (alphas >= 1 / 255) & (weights > 0)
    points, weights = points[seen], weights[seen]
    if not len(points):
        raise ArgumentError(
            "no visible splat with finite position, scale and opacity: nothing to frame"
        )
    weights = np.minimum(weights, 4 * np.median(weights))
    center = np.array([_quantile(axis, weights, 0.5) for axis in points.T])
    distances = np.linalg.norm(points - center, axis=1)
    body = distances <= 2 * _quantile(distances, weights, 0.8)
    points, weights = points[body], weights[body]
    low, high = (
        np.array([_quantile(axis, weights, q) for axis in points.T]) for q in (0.005, 0.995)
    )
    center = (low + high) / 2
    distances = np.linalg.norm(points - center, axis=1)
    spread = float(np.median(sizes[seen][body][:, 2]))
    return Bounds(center, _quantile(distances, weights, 0.995) + 2 * spread)


def _quantile(values: Array, weights: Array, q: float) -> float:
    order = np.argsort(values)
    mass = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(mass, q * mass[-1])]])


def look_at(position: ArrayLike, target: ArrayLike, up: ArrayLike) -> Array:
    """The (4, 4) viewmat of a camera at ``position`` that sees ``target`` in its middle.

    Raises ArgumentError where the viewing direction is zero or along ``up``.
    """
    eye, goal, above = (np.asarray(a, np.float64) for a in (position, target, up))
    forward = goal - eye
    right = np.cross(forward, above)
    if not np.linalg.norm(right) > 1e-9 * np.linalg.norm(forward) * np.linalg.norm(above):
        raise ArgumentError("a camera can't look along its up direction; lower the elevation")
    right /= np.linalg.norm(right)
    forward /= np.linalg.norm(forward)
    viewmat = np.eye(4)
    viewmat[:3, :3] = [right, np.cross(forward, right), forward]
    viewmat[:3, 3] = -viewmat[:3, :3] @ eye
    return viewmat


def orbit(
    bounds: Bounds,
    azimuths: Iterable[float],
    *,
    elevation: float = 0.0,
    up: str = "y",
    width: int = 512,
    height: int = 512,
    fov: float = FOV,
) -> list[Camera]:
    """Cameras on a circle round the object, all of it in the picture.

    azimuths: degrees; 0 looks at the object's front (the camera on +z for ``up="y"`` and
    ``"-y"``, on -y for ``"z"``, on +y for ``"-z"``), and positive angles move the camera to
    its own right. elevation: degrees above the equator, within ±89. fov: degrees across the
    shorter side of the picture. Raises ArgumentError for an unknown ``up`` or values out of
    range.
    """
    if up not in UPRIGHT:
        raise ArgumentError(f"up is {up!r}, expected one of {', '.join(UPRIGHT)}")
    if not -89 <= elevation <= 89:
        raise ArgumentError(f"elevation is {elevation}°, expected -89 to 89")
    if not 1 <= fov <= 150:
        raise ArgumentError(f"fov is {fov}°, expected 1 to 150")
    if width < 1 or height < 1:
        raise ArgumentError(f"the picture is {width}x{height}, expected at least 1x1")
    right, above, front = UPRIGHT[up]
    distance = MARGIN * bounds.radius / math.sin(math.radians(fov) / 2)
    focal = min(width, height) / 2 / math.tan(math.radians(fov) / 2)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    lift = math.radians(elevation)
    cameras = []
    for azimuth in np.radians(list(azimuths)):
        level = np.cos(azimuth) * front + np.sin(azimuth) * right
        direction = math.cos(lift) * level + math.sin(lift) * above
        position = bounds.center + distance * direction
        cameras.append(Camera(look_at(position, bounds.center, above), K, width, height))
    return cameras


def camera_path(keys: Sequence[Camera], count: int) -> list[Camera]:
    """``count`` cameras on a smooth path through ``keys``, evenly spaced in time.

    Positions and intrinsics follow a Catmull-Rom spline, rotations the shortest arc. The first
    and the last camera are the first and the last key. Raises ArgumentError where there are
    fewer than two keys or the pictures differ in size.
    """
    from scipy.interpolate import CubicHermiteSpline
    from scipy.spatial.transform import Rotation, Slerp

    if len(keys) < 2 or count < 2:
        raise ArgumentError(f"{len(keys)} keys and {count} cameras; expected at least 2 of each")
    if len({(key.width, key.height) for key in keys}) > 1:
        raise ArgumentError("the key cameras differ in picture size; resize them first")
    knots = np.arange(len(keys), dtype=float)
    times = np.linspace(0, len(keys) - 1, count)
    rotations = Slerp(knots, Rotation.from_matrix([key.viewmat[:3, :3] for key in keys]))(times)

    def spline(values: Array) -> Array:
        slopes = np.gradient(values, axis=0)
        return np.asarray(CubicHermiteSpline(knots, values, slopes)(times), np.float64)

    positions = spline(np.array([key.position for key in keys]))
    intrinsics = spline(np.array([key.K for key in keys]))
    cameras = []
    for R, position, K in zip(rotations.as_matrix(), positions, intrinsics, strict=True):
        viewmat = np.eye(4)
        viewmat[:3, :3] = R
        viewmat[:3, 3] = -R @ position
        cameras.append(Camera(viewmat, K, keys[0].width, keys[0].height))
    return cameras
