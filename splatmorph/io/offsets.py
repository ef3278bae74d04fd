"""Coordinates far from their origin: what single precision can hold of them.

A survey's coordinates (UTM, ECEF) are millions of metres, where single precision is half a metre
apart. So an offset is taken off in double precision, kept with the splats, and put back in writing.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from splatmorph.gaussians import Gaussians

FINE = 0.01
"""Rounding of a center that is no more than this part of a splat's size is not seen."""
COARSE = 0.5
"""A file whose centers are rounded to this part of a splat's size, or more, has lost detail."""

Offset = tuple[float, float, float]


def without_offset(
    means: NDArray[Any], log_scales: NDArray[Any]
) -> tuple[NDArray[np.float32], Offset]:
    """Centers (n, 3) in single precision, and what was taken off them: zeros where they allow it.

    Bit for bit, what is left and the offset add up to what single precision could hold before.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        # What is not finite is refused elsewhere.
        x, y, z = _offset(means, log_scales).tolist()
        left = means - np.array([x, y, z]) if x or y or z else means
        return left.astype(np.float32), (x, y, z)


def with_offset(gaussians: Gaussians) -> NDArray[Any]:
    """Centers (n, 3) as the file says them: float32 where that holds them, else float64."""
    if not any(gaussians.offset):
        return gaussians.means.detach().cpu().numpy()
    exact = gaussians.absolute_means.detach().cpu().numpy()
    rounded = exact.astype(np.float32)
    return rounded if (rounded == exact).all() else exact


def about(gaussians: Gaussians, offset: Offset) -> Gaussians:
    """The same splats with another offset taken off their centers."""
    means = gaussians.absolute_means - torch.tensor(offset, dtype=torch.float64)
    return replace(gaussians, means=means.float(), offset=offset)


def lost_detail(gaussians: Gaussians) -> float | None:
    """To what the file's single precision rounds the centers; None where that isn't seen."""
    if not any(gaussians.offset) or with_offset(gaussians).dtype != np.float32:
        return None
    spacing = float(np.spacing(np.float32(max(map(abs, gaussians.offset)))))
    size = _typical_size(gaussians.log_scales.detach().cpu().numpy())
    return spacing if spacing > COARSE * size else None


def _offset(means: NDArray[Any], log_scales: NDArray[Any]) -> NDArray[np.float64]:
    none = np.zeros(3)
    if not len(means) or not _spacing(means) > FINE * _typical_size(log_scales):
        return none
    middle = np.median(means, axis=0).astype(np.float64)
    extent = float(np.quantile(np.abs(means - middle).max(axis=1), 0.98))
    if not 0 < extent < np.abs(middle).max():
        return none
    # A multiple of what single precision rounds to, so that taking it off rounds nothing.
    step = 2.0 ** math.ceil(math.log2(extent))
    return np.round(middle / step) * step


def _typical_size(log_scales: NDArray[Any]) -> float:
    """Median of the largest standard deviation of a splat."""
    return float(np.exp(np.median(log_scales.max(axis=1)))) if len(log_scales) else 0.0


def _spacing(means: NDArray[Any]) -> float:
    """Distance between neighbouring float32 numbers as large as the typical center."""
    return (
        float(np.spacing(np.float32(np.abs(np.median(means, axis=0)).max()))) if len(means) else 0.0
    )
