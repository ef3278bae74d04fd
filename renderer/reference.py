"""The per-pixel twin of ``rasterize``: float64, brute force, slow and obvious.

It says what is right. Every splat meets every pixel, in order of depth; there are no tiles,
no bounds and no approximations. See ``docs/conventions.md`` for the choices made here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

BLUR = 0.3
"""Variance in px² that is added to every projected splat, so that none falls between pixels."""
ALPHA_MAX = 0.99
ALPHA_MIN = 1 / 255
TRANSMITTANCE_MIN = 1e-4
NEAR = 0.003
"""The near plane, as a part of the distance at which the splats are."""
SAMPLED = 1000
FOV_MARGIN = 0.3
"""Splats are linearised at most this many half fields of view outside the picture."""

Array = NDArray[np.float64]

# fmt: off
_C0 = 0.28209479177387814
_C1 = 0.4886025119029199
_C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
_C3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154,
       1.445305721320277)
_C4 = (2.5033429417967046, 1.7701307697799304, 0.9461746957575601, 0.6690465435572892,
       0.10578554691520431, 0.47308734787878004, 0.6258357354491761)
# fmt: on


def sh_basis(directions: Array, degree: int) -> Array:
    """Real spherical harmonics in the order and with the signs of the Inria code.

    directions: (n, 3) unit vectors; returns (n, (degree + 1)**2), degree 0 to 4.
    """
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    bands = [
        [np.full_like(x, _C0)],
        [-_C1 * y, _C1 * z, -_C1 * x],
        [
            _C2[0] * x * y,
            -_C2[0] * y * z,
            _C2[1] * (2 * zz - xx - yy),
            -_C2[0] * x * z,
            _C2[2] * (xx - yy),
        ],
        [
            -_C3[0] * y * (3 * xx - yy),
            _C3[1] * x * y * z,
            -_C3[2] * y * (4 * zz - xx - yy),
            _C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            -_C3[2] * x * (4 * zz - xx - yy),
            _C3[4] * z * (xx - yy),
            -_C3[0] * x * (xx - 3 * yy),
        ],
        [
            _C4[0] * x * y * (xx - yy),
            -_C4[1] * y * z * (3 * xx - yy),
            _C4[2] * x * y * (7 * zz - 1),
            -_C4[3] * y * z * (7 * zz - 3),
            _C4[4] * (zz * (35 * zz - 30) + 3),
            -_C4[3] * x * z * (7 * zz - 3),
            _C4[5] * (xx - yy) * (7 * zz - 1),
            -_C4[1] * x * z * (xx - 3 * yy),
            _C4[6] * (xx * (xx - 3 * yy) - yy * (3 * xx - yy)),
        ],
    ]
    return np.stack([value for band in bands[: degree + 1] for value in band], axis=1)


def rotations(quats: Array) -> Array:
    """(n, 4) quaternions wxyz of any length -> (n, 3, 3) rotations local → world."""
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


class Projected(NamedTuple):
    """Splats on the picture, in pixels."""

    centers: Array  # (n, 2)
    covariances: Array  # (n, 2, 2)
    depths: Array  # (n,) along the viewing axis, world units


def project(
    means: Array, quats: Array, scales: Array, viewmat: Array, K: Array, width: int, height: int
) -> Projected:
    """EWA: Σ₂ᴅ = J W Σ Wᵀ Jᵀ + 0.3·I (Zwicker et al. 2001), linearised at the splat's center."""
    R, t = viewmat[:3, :3], viewmat[:3, 3]
    focal = np.array([K[0, 0], K[1, 1]])
    principal = np.array([K[0, 2], K[1, 2]])
    size = np.array([width, height])
    camera = means @ R.T + t
    depths = camera[:, 2]
    slopes = camera[:, :2] / depths[:, None]
    margin = FOV_MARGIN * size / (2 * focal)
    clamped = np.clip(slopes, -principal / focal - margin, (size - principal) / focal + margin)
    J = np.zeros((len(means), 2, 3))
    J[:, 0, 0] = focal[0] / depths
    J[:, 1, 1] = focal[1] / depths
    J[:, :, 2] = -focal * clamped / depths[:, None]
    M = J @ R @ (rotations(quats) * scales[:, None, :])
    covariances = M @ M.transpose(0, 2, 1) + BLUR * np.eye(2)
    return Projected(slopes * focal + principal, covariances, depths)


def rasterize_reference(
    means: ArrayLike,
    quats: ArrayLike,
    scales: ArrayLike,
    opacities: ArrayLike,
    sh: ArrayLike,
    viewmat: ArrayLike,
    K: ArrayLike,
    width: int,
    height: int,
    *,
    background: Sequence[float] | None = None,
    near: float | None = None,
    far: float = 1e10,
    sh_degree: int | None = None,
    depth: str = "expected",
    surface_share: float = 0.3,
) -> tuple[Array, Array, Array]:
    """One picture, every splat at every pixel, in float64. Arguments as ``rasterize``.

    Returns rgb (height, width, 3), alpha (height, width), depth (height, width).
    """
    arrays = [np.asarray(a, np.float64) for a in (means, quats, scales, opacities, sh)]
    camera = np.asarray(viewmat, np.float64), np.asarray(K, np.float64)
    depths = (near_of(arrays[0], camera[0]) if near is None else near, far)
    _, splats, alphas, colors = _visible(arrays, *camera, width, height, depths, sh_degree)
    rgb = np.zeros((height, width, 3))
    mean = np.zeros((height, width))
    transmittance = np.ones((height, width))
    added: list[tuple[float, Array]] = []
    for i, weight in _shares(splats, alphas, width, height):
        rgb += weight[..., None] * colors[i]
        mean += weight * splats.depths[i]
        transmittance -= weight
        added.append((splats.depths[i], weight))

    covered = 1 - transmittance
    if background is not None:
        rgb += transmittance[..., None] * np.asarray(background, np.float64)
    if depth == "surface":
        return rgb, covered, _surface(added, surface_share * covered)
    mean = np.divide(mean, covered, out=np.zeros_like(mean), where=covered > 0)
    return rgb, covered, mean


def _surface(added: Sequence[tuple[float, Array]], goal: Array) -> Array:
    """The depth with which what the splats add, front to back, reaches the goal in each pixel."""
    gathered, surface = np.zeros_like(goal), np.zeros_like(goal)
    for depth, weight in added:
        before, gathered = gathered, gathered + weight
        surface[(goal > 0) & (before < goal) & (gathered >= goal)] = depth
    return surface


def gather_reference(
    means: ArrayLike,
    quats: ArrayLike,
    scales: ArrayLike,
    opacities: ArrayLike,
    viewmat: ArrayLike,
    K: ArrayLike,
    picture: ArrayLike,
    *,
    near: float | None = None,
    far: float = 1e10,
) -> Array:
    """Σₚ wᵢₚ xₚ of one picture (height, width, k), in float64: (n, k). Arguments as ``gather``."""
    arrays = [np.asarray(a, np.float64) for a in (means, quats, scales, opacities)]
    values = np.asarray(picture, np.float64)
    height, width, channels = values.shape
    camera = np.asarray(viewmat, np.float64), np.asarray(K, np.float64)
    scene = [*arrays, np.zeros((len(arrays[0]), 1, 3))]
    depths = (near_of(arrays[0], camera[0]) if near is None else near, far)
    drawn, splats, alphas, _ = _visible(scene, *camera, width, height, depths, None)
    sums = np.zeros((len(arrays[0]), channels))
    for i, weight in _shares(splats, alphas, width, height):
        sums[drawn[i]] = np.einsum("hw,hwk->k", weight, values)
    return sums


def _shares(
    splats: Projected, alphas: Array, width: int, height: int
) -> Iterator[tuple[int, Array]]:
    """What each splat adds to every pixel, (height, width), front to back."""
    pixels = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)
    transmittance = np.ones((height, width))
    unfinished = np.ones((height, width), bool)
    for i in np.argsort(splats.depths, kind="stable"):
        offset = pixels - splats.centers[i]
        conic = np.linalg.inv(splats.covariances[i])
        falloff = np.exp(-0.5 * np.einsum("...i,ij,...j", offset, conic, offset))
        alpha = np.minimum(alphas[i] * falloff, ALPHA_MAX)
        hit = unfinished & (alpha >= ALPHA_MIN)
        remaining = transmittance * (1 - alpha)
        unfinished &= ~(hit & (remaining < TRANSMITTANCE_MIN))
        hit &= unfinished
        yield int(i), np.where(hit, transmittance * alpha, 0)
        transmittance = np.where(hit, remaining, transmittance)


def near_of(means: NDArray[Any], viewmat: Array) -> float:
    """A near plane for splats (n, 3), whatever their unit: ``NEAR`` of their median distance."""
    some = means[:: max(1, len(means) // SAMPLED)]
    with np.errstate(over="ignore", invalid="ignore"):
        distances = np.abs(some @ viewmat[2, :3] + viewmat[2, 3])
    distances = distances[np.isfinite(distances) & (distances > 0)]
    return NEAR * float(np.median(distances)) if len(distances) else NEAR


def _visible(
    arrays: Sequence[Array],
    viewmat: Array,
    K: Array,
    width: int,
    height: int,
    depths: tuple[float, float],
    sh_degree: int | None,
) -> tuple[NDArray[np.intp], Projected, Array, Array]:
    """Splats that can be drawn: which, projected, their opacities and their colours."""
    means, quats, _, opacities, _ = arrays
    near, far = depths
    depth = means @ viewmat[2, :3] + viewmat[2, 3]
    finite = np.logical_and.reduce([np.isfinite(a.reshape(len(a), -1)).all(1) for a in arrays[:4]])
    drawn = finite & (depth > near) & (depth < far) & (opacities >= ALPHA_MIN)
    drawn &= np.linalg.norm(quats, axis=1) > 0
    means, quats, scales, opacities, sh = (a[drawn] for a in arrays)
    degree = math.isqrt(sh.shape[1]) - 1 if sh_degree is None else sh_degree
    rays = means + np.linalg.inv(viewmat[:3, :3]) @ viewmat[:3, 3]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    basis = sh_basis(rays, degree)
    colors = np.fmax(np.einsum("nk,nkc->nc", basis, sh[:, : basis.shape[1]]) + 0.5, 0)
    projected = project(means, quats, scales, viewmat, K, width, height)
    return np.flatnonzero(drawn), projected, opacities, colors
