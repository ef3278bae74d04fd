"""What a point looks like from outside: histograms of gradients of light and of relief.

Like DAISY (Tola et al. 2010), but of unsigned gradients, so that a dark mouth in a fair face is
one with a pale mouth in a dark face; and beside the luminance of the picture its relief, the
depth without its coarse part, which two people share whatever their colours. Both splats are
seen by the same cameras, so that no orientation need be found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from splatmorph.gaussians import Gaussians
from splatmorph.registration.views import MATCHED, Array, Cameras, around, photograph

VIEWS, SIDE = 14, 192
ROOM = 1.9
"""Radius of the ball that the cameras keep in view, in root mean square radii of the object."""
BELT = 0.8
"""The cameras keep this far from the poles: pictures from right above tell little."""
BINS = 6
SCALES = ((2.5, 1), (6.0, 2))
"""Pixels, and how many of them are one where gradients are histogrammed: the coarse see no more in
full. A descriptor's 3 × 3 cells lie two scales apart."""
CELLS = 9
CLIP = 0.3
"""Most that one component may be of the descriptor's length."""
RELIEF = 12.0
"""Pixels; depth blurred by these is the coarse shape."""
SMOOTH = 1.5
"""Pixels by which depth is smoothed first."""
SOLID = 0.5
BEHIND = 6.0
"""Pixels' worth of depth by which a point may differ from what its pixel shows."""
FACING = 0.2
LEAST = 0.1
"""Weight below which a view of a point counts for nothing."""
COMMON = 0.05
"""Weight of all views in common below which two points can't be compared."""
UNKNOWN = 0.62
"""Distance of two points that no camera sees both: that of a typical pair."""


@dataclass(frozen=True)
class Seen:
    """What one camera sees of some points."""

    index: Tensor
    """(m,) which of the points."""
    weights: Tensor
    """(m,) cos² of the angle between normal and view."""
    values: Tensor
    """(m, d) unit vectors."""


def cameras_of(center: Array, radius: float = 1.0) -> Cameras:
    """The cameras that two splats are compared from."""
    return around(center, ROOM * radius, VIEWS, SIDE, belt=BELT)


def describe(gaussians: Gaussians, points: Array, normals: Array, cameras: Cameras) -> list[Seen]:
    """How oriented points (n, 3) on a splat look from each camera."""
    pictures = photograph(gaussians, cameras, depth=MATCHED)
    light = torch.from_numpy(pictures.rgb.mean(-1) + (1 - pictures.alpha) * 0.5)
    depth = np.where(pictures.alpha > SOLID, pictures.depth, np.nan)
    visible = [_visible(cameras, i, points, normals, depth[i]) for i in range(len(cameras))]
    channels = torch.stack([light, _relief(torch.from_numpy(depth), cameras.focal)], 1)
    norm = math.sqrt(channels.shape[1] * len(SCALES))
    energies = [_energies(channels.flatten(0, 1), scale, stride) for scale, stride in SCALES]
    seen = []
    for i, (index, weights, pixels) in enumerate(visible):
        cells = [
            _cells(of_scale[i * channels.shape[1] + channel], scale / stride, pixels // stride)
            for channel in range(channels.shape[1])
            for of_scale, (scale, stride) in zip(energies, SCALES, strict=True)
        ]
        seen.append(Seen(index, weights, torch.cat(cells, 1) / norm))
    return seen


def distances(a: list[Seen], b: list[Seen], count: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Mean squared distance (n, m) of two sets' descriptors over the views that see both, 0 to 2,
    and the weight (n, m) of those views; ``count`` is (n, m)."""
    # The views' Σ w·w'·|x - x'|² = 2 Σ w·w' - 2 Σ (w·x)·(w'·x'), as all x have length 1.
    alike = torch.zeros(count)
    for one, other in zip(a, b, strict=True):
        if len(one.index) and len(other.index):
            x, y = (side.weights[:, None] * side.values for side in (one, other))
            rows = x.new_zeros(len(x), count[1])
            rows[:, other.index] = x @ y.T
            alike.index_add_(0, one.index, rows)
    weight = _weights(a, count[0]) @ _weights(b, count[1]).T
    unlike = (weight - alike).mul_(2).div_(weight.clamp_min(COMMON))
    return unlike.masked_fill_(weight <= COMMON, UNKNOWN), weight


def _weights(seen: list[Seen], count: int) -> Tensor:
    """(count, c): the weight of each point in each view."""
    weights = torch.zeros(count, len(seen))
    for column, one in zip(weights.T, seen, strict=True):
        column[one.index] = one.weights
    return weights


def _visible(
    cameras: Cameras, number: int, points: Array, normals: Array, depth: Array
) -> tuple[Tensor, Tensor, Tensor]:
    """Which points a camera sees, their weights and their pixels (m, 2)."""
    seen = cameras.of_camera(number, points)
    pixels = np.clip(cameras.pixels(seen).astype(int), 0, cameras.side - 1)
    shown = depth[pixels[:, 1], pixels[:, 0]]
    facing = -(normals @ cameras.viewmats[number, :3, :3].T * seen).sum(1)
    facing /= np.linalg.norm(seen, axis=1)
    solid = np.isfinite(depth)
    pixel = depth[solid].mean() / cameras.focal if solid.any() else 0.0
    with np.errstate(invalid="ignore"):
        in_sight = (np.abs(shown - seen[:, 2]) < BEHIND * pixel) & (facing > FACING)
    weights = np.where(in_sight, facing**2, 0)
    index = np.flatnonzero(weights > LEAST)
    return (
        torch.from_numpy(index),
        torch.from_numpy(weights[index]).float(),
        torch.from_numpy(pixels[index]),
    )


def _relief(depth: Tensor, focal: float) -> Tensor:
    """Depth without its coarse part, in pixels: (c, h, w), nan where nothing is."""
    solid = depth.isfinite()
    share = blur(solid.float(), SMOOTH)
    filled = blur(torch.where(solid, depth, 0.0).float(), SMOOTH) / share.clamp_min(0.05)
    views = depth.flatten(1)
    far = torch.where(solid.flatten(1), views, -torch.inf).amax(1).clamp_min(0)
    shape = torch.where(share > 0.05, filled, far[:, None, None])
    pixel = (torch.nansum(views, 1) / solid.flatten(1).sum(1).clamp_min(1) / focal)[:, None, None]
    shape = shape / pixel.clamp_min(1e-12)
    return shape - blur(shape, RELIEF)


def _energies(pictures: Tensor, scale: float, stride: int) -> Tensor:
    """Gradient energy by unsigned direction, blurred: (c, n, n) -> (c, BINS, n / stride, …)."""
    smooth = blur(pictures, scale / 3, stride)
    down, across = torch.gradient(smooth, dim=(1, 2))
    # With the gradient's length g and direction θ: g·cos²(2θ - turn) where the cosine is positive.
    square = across.square() + down.square() + 1e-20
    share = square.pow(-0.75)
    cosine, sine = (across.square() - down.square()) * share, 2 * across * down * share
    energies = pictures.new_empty(len(pictures), BINS, *smooth.shape[1:])
    for number in range(BINS):
        turn = 2 * math.pi * number / BINS
        along = (cosine * math.cos(turn)).add_(sine, alpha=math.sin(turn)).clamp_min_(0)
        energies[:, number] = blur(along.square_(), scale / stride)
    return energies


def _cells(energies: Tensor, scale: float, pixels: Tensor) -> Tensor:
    """Descriptors (m, CELLS · BINS) at pixels (m, 2) of a picture's energies (BINS, h, w)."""
    step, side = round(2 * scale), energies.shape[-1]
    x, y = pixels.T
    cells = [
        energies[:, (y + dy).clamp(0, side - 1), (x + dx).clamp(0, side - 1)]
        for dy in (-step, 0, step)
        for dx in (-step, 0, step)
    ]
    value = torch.cat(cells).T
    value = (value / (value.norm(dim=1, keepdim=True) + 1e-9)).clamp_max(CLIP)
    return value / (value.norm(dim=1, keepdim=True) + 1e-9)


def blur(pictures: Tensor, sigma: float, stride: int = 1) -> Tensor:
    """Gaussian blur of square pictures (c, n, n), mirrored at the border: B·picture·Bᵀ.

    With a stride, of the middles of blocks of so many pixels: (c, n / stride, n / stride).
    """
    matrix = _blur_matrix(pictures.shape[-1], sigma, stride).to(pictures)
    across = pictures @ matrix.T
    return torch.bmm(matrix.expand(len(pictures), *matrix.shape), across)


def _blur_matrix(side: int, sigma: float, stride: int) -> Tensor:
    middles = stride * torch.arange(side // stride) + (stride - 1) / 2
    reach = int(3 * sigma + 0.5) + stride - 1
    where = middles[:, None].floor().long() + torch.arange(-reach, reach + 1)
    weights = torch.exp(-0.5 * ((where - middles[:, None]) / sigma) ** 2)
    where = where % (2 * side)
    where = torch.where(where < side, where, 2 * side - 1 - where)
    weights /= weights.sum(1, keepdim=True)
    return torch.zeros(len(middles), side).scatter_add_(1, where, weights)
