"""The surface that the eye sees, as oriented points from depth pictures all round.

Splat centers are a poor surface: most lie inside, in haze, or where training happened to leave
many. What the pixels hit is the same for two captures however their splats are spread.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from renderer.rasterize import Depth
from splatmorph.errors import LandmarkError
from splatmorph.gaussians import Gaussians
from splatmorph.registration.views import Array, Cameras, Pictures, around, photograph
from splatmorph.rendering import bounds_of, renderer_arrays

VIEWS, SIDE = 24, 160
SOLID = 0.6
"""Alpha from which a pixel is surface."""
SLANT = 0.25
"""Least cosine between normal and view: nearer to the silhouette depth means little."""
JUMP = 8.0
"""Pixels' worth of depth across two pixels: more is an edge between two surfaces."""
DENSE = 8000
RADII = (0.1, 0.2, 0.35, 0.6)
"""Of the balls in which shape is described, in radii of the object."""
COLOUR_RADII = (0.2, 0.6)
NEIGHBOURHOOD = 4000
"""Points are enough to describe neighbourhoods by."""
CHUNK = 500
"""Points at a time, of which the distances to them fit the caches."""
FEWEST = 200


@dataclass(frozen=True)
class Surface:
    """n oriented points on a surface."""

    points: Array
    """(n, 3)"""
    normals: Array
    """(n, 3) unit vectors that point outwards."""
    features: NDArray[np.float32]
    """(n, d) shape and colour around each point, whatever the pose: robust z-scores."""

    def __len__(self) -> int:
        return len(self.points)

    def select(self, index: NDArray[np.integer]) -> Surface:
        """The points at ``index``."""
        return Surface(self.points[index], self.normals[index], self.features[index])


def see_surface(gaussians: Gaussians, depth: Depth = "surface") -> tuple[Surface, Array, float]:
    """Some 8000 points of the surface, and the object's center (3,) and root mean square radius.

    Everything in the units of the splat; the normals' sign is that of the side seen; ``depth`` as
    the renderer's.

    Raises:
        LandmarkError: next to no surface is to be seen.
    """
    points, normals, colours, center, radius = _seen(gaussians, depth)
    return Surface(points, normals, _features(points, normals, colours, radius)), center, radius


def surface_points(gaussians: Gaussians) -> tuple[Array, float]:
    """The points (n, 3) that ``see_surface`` finds, described by nothing, and the radius.

    Raises:
        LandmarkError: as ``see_surface``.
    """
    points, _, _, _, radius = _seen(gaussians, "surface")
    return points, radius


def _seen(gaussians: Gaussians, depth: Depth) -> tuple[Array, Array, Array, Array, float]:
    """Points, normals and colours of the surface, the object's center and radius."""
    means, _, scales, opacities, _ = renderer_arrays(gaussians)
    bounds = bounds_of(means, opacities, scales)
    cameras = around(bounds.center, 1.02 * bounds.radius, VIEWS, SIDE)
    points, normals, colours, weights = _lifted(
        cameras, photograph(gaussians, cameras, depth=depth)
    )
    if len(points) < FEWEST:
        raise LandmarkError(
            f"the splat shows {len(points)} pixels of solid surface in {VIEWS} pictures of it, "
            "expected an object that light doesn't pass: landmarks must be given"
        )
    points, mass, mean = voxels(points, weights, np.concatenate([normals, colours], 1), DENSE)
    normals, colours = mean[:, :3], mean[:, 3:]
    coherence = np.linalg.norm(normals, axis=1)
    normals = normals / (coherence[:, None] + 1e-9)
    spacing = cKDTree(points).query(points, 9)[0][:, 1:].mean(1)
    kept = (spacing < 3 * np.median(spacing)) & (mass > 0.05 * np.median(mass)) & (coherence > 0.3)
    points, normals, colours = points[kept], normals[kept], colours[kept]
    center, radius = _robust_ball(points)
    near = np.linalg.norm(points - center, axis=1) < 4 * radius
    return points[near], normals[near], colours[near], center, radius


def _lifted(cameras: Cameras, pictures: Pictures) -> tuple[Array, Array, Array, Array]:
    """World points, normals, colours and weights of all pixels that show a surface."""
    side, focal = cameras.side, cameras.focal
    raster = np.arange(side) + 0.5
    rays = (np.stack(np.meshgrid(raster, raster), -1) - side / 2) / focal
    rays = np.concatenate([rays, np.ones_like(rays[..., :1])], -1)
    found: list[tuple[Array, ...]] = []
    for viewmat, rgb, alpha, depth in zip(
        cameras.viewmats, pictures.rgb, pictures.alpha, pictures.depth, strict=True
    ):
        seen = rays * depth[..., None]
        across, down = np.zeros_like(seen), np.zeros_like(seen)
        across[:, 1:-1] = seen[:, 2:] - seen[:, :-2]
        down[1:-1] = seen[2:] - seen[:-2]
        normals = np.cross(down, across)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True) + 1e-12
        solid = alpha > SOLID
        kept = solid.copy()
        for axis in (0, 1):
            for shift in (-1, 1):
                kept &= np.roll(solid, shift, axis)
        pixel = np.maximum(depth, 1e-12) / focal
        kept &= (np.abs(across[..., 2]) < JUMP * pixel) & (np.abs(down[..., 2]) < JUMP * pixel)
        cosine = -(normals * seen).sum(-1) / (np.linalg.norm(seen, axis=-1) + 1e-12)
        kept &= cosine > SLANT
        R, t = viewmat[:3, :3], viewmat[:3, 3]
        found.append(
            (
                (seen[kept] - t) @ R,
                normals[kept] @ R,
                (rgb[kept] / alpha[kept][:, None]).astype(np.float64),
                cosine[kept] ** 2,
            )
        )
    points, normals, colours, weights = (np.concatenate(part) for part in zip(*found, strict=True))
    return points, normals, colours, weights


def voxels(points: Array, weights: Array, values: Array, count: int) -> tuple[Array, Array, Array]:
    """About ``count`` cells of a grid: mean point, mass and mean values of each."""
    low = points.min(0)
    extent = float(np.ptp(points, axis=0).max())
    shortest, longest = extent / 400, extent
    for _ in range(12):
        cell = math.sqrt(shortest * longest)
        key = np.floor((points - low) / cell).astype(np.int64) @ np.array([1 << 40, 1 << 20, 1])
        full = len(np.unique(key))
        if abs(full - count) < 0.01 * count:
            break
        shortest, longest = (cell, longest) if full > count else (shortest, cell)
    _, inverse = np.unique(key, return_inverse=True)
    mass = np.bincount(inverse, weights).astype(np.float64)

    def mean(columns: Array) -> Array:
        sums = [np.bincount(inverse, weights * column) for column in columns.T]
        return np.stack(sums, 1) / mass[:, None]

    return mean(points), mass, mean(values)


def _robust_ball(points: Array) -> tuple[Array, float]:
    """Center and root mean square radius of the points that aren't far out."""
    center = np.median(points, 0)
    radius = 0.0
    for _ in range(5):
        distance = np.linalg.norm(points - center, axis=1)
        near = distance[distance < 2.5 * np.median(distance)]
        radius = math.sqrt((near**2).mean())
        center = points[distance < 2.5 * radius].mean(0)
    return center, radius


def _features(points: Array, normals: Array, colours: Array, radius: float) -> NDArray[np.float32]:
    """Signed curvature and roughness in balls of four sizes, colour and its contrast."""
    few = np.random.default_rng(0).permutation(len(points))[:NEIGHBOURHOOD]
    own, facing, shades = (
        torch.from_numpy(value).float()
        for value in ((points - points.mean(0)) / radius, normals, colours)
    )
    around = torch.cat([torch.ones(len(few), 1), own[few], facing[few], shades[few]], 1)
    parts = zip(own.split(CHUNK), facing.split(CHUNK), shades.split(CHUNK), strict=True)
    rows = [_neighbourhood(*part, own[few], around) for part in parts]
    features = np.concatenate([torch.cat(rows).double().numpy(), colours], 1)
    middle = np.median(features, 0)
    spread = 1.4826 * np.median(np.abs(features - middle), 0) + 1e-3
    return np.clip((features - middle) / spread, -3, 3).astype(np.float32)


def _neighbourhood(
    points: Tensor, normals: Tensor, colours: Tensor, few: Tensor, around: Tensor
) -> Tensor:
    """Columns (n, d) of what points' neighbourhoods are like; ``around`` holds a one, the point,
    its normal and its colours of each of the ``few`` that stand for all."""
    squares = torch.cdist(points, few).square_()
    columns = []
    for reach in RADII:
        near = (1 - squares / reach**2).clamp_min_(0)
        sums = near @ around
        middle, facing, shade = (sums[:, 1:] / sums[:, :1].clamp_min(1e-3)).split(3, 1)
        columns.append(((points - middle) * normals).sum(1) / reach)
        columns.append(1 - (facing * normals).sum(1))
        if reach in COLOUR_RADII:
            columns.append((colours - shade).mean(1))
    return torch.stack(columns, 1)
