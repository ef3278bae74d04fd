"""``rasterize``: Gaussian splats in, a picture out."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import native
from renderer.errors import ArgumentError
from renderer.reference import near_of
from renderer.views import View, view_of

MAX_SIDE = 16384
"""Pixels; tile coordinates stay well inside the kernels' integers."""
Depth = Literal["expected", "surface"]
MOST_SHARE = 0.99


def rasterize(
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
    depth: Depth = "expected",
    surface_share: float = 0.3,
    device: str = "cpu",
    threads: int | None = None,
) -> tuple[Any, Any, Any]:
    """Render Gaussian splats by EWA splatting (Zwicker et al. 2001; Kerbl et al. 2023).

    Arguments
        means (n, 3): centers, world units.
        quats (n, 4): rotations local → world, wxyz, of any length but zero.
        scales (n, 3): standard deviations along the local axes, world units.
        opacities (n,): in [0, 1].
        sh (n, (degree + 1)**2, 3): colour coefficients, degree 0 to 4, RGB last.
        viewmat (4, 4) or (c, 4, 4): world → camera, OpenCV axes (x right, y down, z ahead).
        K (3, 3) or (c, 3, 3): camera → pixels, without skew.
        width, height: pixels.

    Options
        background: RGB behind the splats; none leaves the colours premultiplied on black.
        near, far: splats whose center is not between these depths are not drawn; ``near`` is
            by default a few thousandths of the distance at which the splats are.
        sh_degree: use the bands up to this degree; all by default.
        depth: "expected" is the mean of the splats' depths, weighted by what each adds to the
            pixel; "surface" the depth of the splat with which a share of the pixel's alpha is
            gathered, front to back: what is seen, where the mean lies behind it in the haze.
        surface_share: that share, above 0 and at most 0.99.
        device: "cpu", or "cuda:0" and the like.
        threads: how many draw on a CPU, all cores by default; never changes the picture.

    Returns ``rgb`` (height, width, 3), ``alpha`` (height, width) and the depth (height, width)
    along the viewing axis, 0 where there is none. With c cameras each has a leading axis of
    length c. float32; torch tensors if ``means`` is one, numpy arrays otherwise. Float32 arrays
    in C order are read in place.

    Splats with a value that is not finite, or a zero quaternion, are not drawn. Raises
    ArgumentError for shapes or numbers that can't be rendered.
    """
    scene = _checked_scene(means, quats, scales, opacities, sh)
    stored = math.isqrt(scene["sh"].shape[1]) - 1
    degree = stored if sh_degree is None else sh_degree
    if not 0 <= degree <= stored:
        raise ArgumentError(f"sh_degree is {degree}, expected 0 to {stored}, the degree of sh")
    behind = np.zeros(3) if background is None else np.asarray(background, np.float64)
    if behind.shape != (3,) or not np.isfinite(behind).all():
        raise ArgumentError(f"background is {background!r}, expected three finite numbers, RGB")
    if depth not in ("expected", "surface"):
        raise ArgumentError(f"depth is {depth!r}, expected 'expected' or 'surface'")
    if not 0 < surface_share <= MOST_SHARE:
        raise ArgumentError(
            f"surface_share is {surface_share}, expected above 0 and at most {MOST_SHARE}"
        )
    share = surface_share if depth == "surface" else 0.0
    views = _checked_views(viewmat, K, (width, height), (near, far), scene["means"], threads)
    if device == "cpu" and native.PROGRAM.available():
        pictures = native.render(scene, degree, views, behind, share, threads)
    else:
        from renderer import portable

        portable.check_device(device)
        pictures = portable.render(scene, degree, views, behind, share, device)
    single = np.ndim(viewmat) == 2 and np.ndim(K) == 2
    rgb, alpha, depths_seen = (_like(means, one[0] if single else one) for one in pictures)
    return rgb, alpha, depths_seen


def gather(
    means: ArrayLike,
    quats: ArrayLike,
    scales: ArrayLike,
    opacities: ArrayLike,
    viewmat: ArrayLike,
    K: ArrayLike,
    pictures: ArrayLike,
    *,
    near: float | None = None,
    far: float = 1e10,
    device: str = "cpu",
    threads: int | None = None,
) -> Any:
    """What pictures say to each splat: the transpose of ``rasterize`` in its colours.

    In a picture splat i has the share wᵢₚ in pixel p, its alpha there times what is left of the
    light behind; the picture is Σᵢ wᵢₚ cᵢ. This is Σₚ wᵢₚ xₚ, for values xₚ at the pixels.

    Arguments
        means, quats, scales, opacities, viewmat, K: as for ``rasterize``.
        pictures (h, w, k), or (c, h, w, k) for c cameras: the values x, k of them a pixel.

    Options
        as for ``rasterize``.

    Returns (n, k) float32, summed over pixels and cameras: a torch tensor if ``means`` is one,
    a numpy array otherwise. Sums are made in whole numbers, so that neither threads nor their
    order change a bit; their grain is below 1e-9 of the largest value times the pixels.

    Raises ArgumentError for shapes or numbers that can't be used.
    """
    arrays = (means, quats, scales, opacities)
    scene = _checked_scene(*arrays, np.zeros((np.shape(means)[0] if np.ndim(means) else 0, 1, 3)))
    values = _as_numpy("pictures", pictures, np.float32)
    single = np.ndim(viewmat) == 2 and np.ndim(K) == 2
    if single and values.ndim == 3:
        values = values[None]
    if values.ndim != 4 or not values.shape[-1]:
        raise ArgumentError(f"pictures has shape {np.shape(pictures)}, expected ([c,] h, w, k)")
    if not np.isfinite(values).all():
        raise ArgumentError("pictures has values that are not finite")
    count, height, width, channels = values.shape
    views = _checked_views(viewmat, K, (width, height), (near, far), scene["means"], threads)
    if len(views) != count:
        raise ArgumentError(f"{count} pictures and {len(views)} cameras, expected as many of both")

    # So fine that the largest sum there can be fits 62 bits.
    largest = max(float(np.abs(values).max(initial=0)), 1e-30) * width * height * count
    grain = 2.0 ** (62 - math.ceil(math.log2(largest)))
    sums = np.zeros((len(scene["means"]), channels), np.int64)
    for first in range(0, channels, native.MAX_CHANNELS):
        some = slice(first, first + native.MAX_CHANNELS)
        if device == "cpu" and native.PROGRAM.available():
            sums[:, some] = native.gather(scene, views, values[..., some], grain, threads)
        else:
            from renderer import portable

            portable.check_device(device)
            sums[:, some] = portable.gather(scene, views, values[..., some], grain, device)
    return _like(means, (sums / grain).astype(np.float32))


def _checked_views(
    viewmat: ArrayLike,
    K: ArrayLike,
    size: tuple[int, int],
    depths: tuple[float | None, float],
    means: NDArray[np.float32],
    threads: int | None,
) -> list[View]:
    """The kernels' views of the cameras."""
    (width, height), (near, far) = size, depths
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise ArgumentError(f"the picture is {width}x{height}, expected 1 to {MAX_SIDE} a side")
    if not 0 < (far / 2 if near is None else near) < far:
        raise ArgumentError(f"near is {near} and far {far}, expected 0 < near < far")
    if threads is not None and threads < 1:
        raise ArgumentError(f"threads is {threads}, expected at least 1")
    viewmats, Ks = _checked_cameras(viewmat, K)
    views = []
    for one, intrinsics in zip(viewmats, Ks, strict=True):
        closest = near_of(means, one) if near is None else float(near)
        views.append(view_of(one, intrinsics, (int(width), int(height)), (closest, float(far))))
    return views


def _is_torch(array: object) -> bool:
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(array, torch.Tensor)


def _like(model: object, picture: NDArray[np.float32]) -> Any:
    if not _is_torch(model):
        return picture
    import torch

    return torch.from_numpy(picture)


def _as_numpy(name: str, array: Any, dtype: type) -> NDArray[Any]:
    if _is_torch(array):
        array = array.detach().cpu()
    try:
        return np.ascontiguousarray(array, dtype)
    except (ValueError, TypeError) as error:
        raise ArgumentError(f"{name} is no array of numbers: {error}") from error


def _checked_scene(*arrays: ArrayLike) -> dict[str, NDArray[np.float32]]:
    names = ("means", "quats", "scales", "opacities", "sh")
    scene = {
        name: _as_numpy(name, array, np.float32) for name, array in zip(names, arrays, strict=True)
    }
    n = len(scene["means"]) if scene["means"].ndim else 0
    tails = {"means": (3,), "quats": (4,), "scales": (3,), "opacities": ()}
    for name, tail in tails.items():
        if scene[name].shape != (n, *tail):
            expected = ", ".join(map(str, (n, *tail)))
            raise ArgumentError(f"{name} has shape {scene[name].shape}, expected ({expected})")
    shape = scene["sh"].shape
    if shape not in {(n, (degree + 1) ** 2, 3) for degree in range(5)}:
        raise ArgumentError(
            f"sh has shape {shape}, expected ({n}, k, 3) with k one of 1, 4, 9, 16, 25"
        )
    return scene


def _checked_cameras(viewmat: ArrayLike, K: ArrayLike) -> tuple[NDArray[Any], NDArray[Any]]:
    """(c, 4, 4) and (c, 3, 3) in float64."""
    viewmats, Ks = _as_numpy("viewmat", viewmat, np.float64), _as_numpy("K", K, np.float64)
    for name, array, side in (("viewmat", viewmats, 4), ("K", Ks, 3)):
        if array.ndim not in (2, 3) or array.shape[-2:] != (side, side):
            raise ArgumentError(
                f"{name} has shape {array.shape}, expected ({side}, {side}) or (c, {side}, {side})"
            )
        if not np.isfinite(array).all():
            raise ArgumentError(f"{name} has values that are not finite")
    viewmats, Ks = np.atleast_3d(viewmats.T).T, np.atleast_3d(Ks.T).T
    if len(viewmats) != len(Ks) and 1 not in (len(viewmats), len(Ks)):
        raise ArgumentError(f"{len(viewmats)} viewmats and {len(Ks)} Ks, expected as many of both")
    if not ((Ks[:, 0, 0] > 0) & (Ks[:, 1, 1] > 0)).all():
        raise ArgumentError("K has a focal length that is not positive")
    if (np.abs(np.linalg.det(viewmats[:, :3, :3])) < 1e-12).any():
        raise ArgumentError("viewmat is singular: its rotation maps space to a plane")
    count = max(len(viewmats), len(Ks))
    return (
        np.broadcast_to(viewmats, (count, 4, 4)),
        np.broadcast_to(Ks, (count, 3, 3)),
    )
