"""A camera as the kernels want it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from renderer import reference

Array = NDArray[Any]


class View(NamedTuple):
    """World to camera to pixels, and what of it is seen."""

    viewmat: tuple[float, ...]
    """(16,) row by row"""
    to_world: tuple[float, ...]
    """(9,) row by row: directions, camera to world"""
    focal: tuple[float, ...]
    """(2,) px, as the principal point"""
    principal: tuple[float, ...]
    slope_min: tuple[float, ...]
    """(2,) x/z and y/z within which splats are linearised, as the largest ones"""
    slope_max: tuple[float, ...]
    near: float
    far: float
    width: int
    height: int


def view_of(viewmat: Array, K: Array, size: tuple[int, int], depths: tuple[float, float]) -> View:
    """The view of a camera (4, 4), (3, 3), of so many pixels; ``depths`` are near and far."""
    focal, principal = np.diag(K)[:2], K[:2, 2]
    margin = reference.FOV_MARGIN * np.array(size) / (2 * focal)
    return View(
        viewmat=tuple(viewmat.ravel().tolist()),
        to_world=tuple(np.linalg.inv(viewmat[:3, :3]).ravel().tolist()),
        focal=tuple(focal.tolist()),
        principal=tuple(principal.tolist()),
        slope_min=tuple((-principal / focal - margin).tolist()),
        slope_max=tuple(((np.array(size) - principal) / focal + margin).tolist()),
        near=depths[0],
        far=depths[1],
        width=size[0],
        height=size[1],
    )
