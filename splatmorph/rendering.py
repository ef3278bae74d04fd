"""From Gaussians to the renderer's arrays, and the camera moves that show a morph.

The renderer knows nothing of us, so neither do its errors: what is called from here raises ours.
"""

from __future__ import annotations

import functools
import math
import weakref
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from typing import ParamSpec, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

import renderer
from renderer import ArgumentError, Bounds, Camera, CameraFileError, OutputError, RenderError
from renderer.cameras import UPRIGHT
from splatmorph.ahead import ahead
from splatmorph.errors import OptionError, ReadError, SplatmorphError, WriteError
from splatmorph.gaussians import Gaussians
from splatmorph.steady import one_thread

Colour = Sequence[float]
Array = NDArray[np.float32]
Arrays = tuple[Array, Array, Array, Array, Array]

P = ParamSpec("P")
R = TypeVar("R")

ERRORS: dict[type[RenderError], type[SplatmorphError]] = {
    ArgumentError: OptionError,
    CameraFileError: ReadError,
    OutputError: WriteError,
}
"""What the renderer's errors are here."""


def _with_our_errors(function: Callable[P, R]) -> Callable[P, R]:
    @functools.wraps(function)
    def called(*args: P.args, **keywords: P.kwargs) -> R:
        try:
            return function(*args, **keywords)
        except RenderError as error:
            raise ERRORS[type(error)](str(error)) from error

    return called


bounds_of = _with_our_errors(renderer.bounds_of)
gather = _with_our_errors(renderer.gather)
orbit = _with_our_errors(renderer.orbit)
rasterize = _with_our_errors(renderer.rasterize)

SWING = 40.0
"""Degrees to each side that a turntable of a morph swings: heads from one picture have no back."""


def render(
    gaussians: Gaussians,
    camera: Camera,
    *,
    background: Colour | None = (1.0, 1.0, 1.0),
    device: str = "cpu",
) -> NDArray[np.uint8]:
    """The picture of a splat.

    Args:
        gaussians: what to render.
        camera: from where, and how large.
        background: RGB in [0, 1]; None for a transparent one.
        device: where the rasterizer runs.

    Returns:
        (height, width, 3) uint8; with a transparent background (height, width, 4), straight
        (unassociated) alpha.

    Raises:
        OptionError: a picture of no size, a camera or a splat that can't be drawn.
    """
    return _picture(renderer_arrays(gaussians), camera, background, device)


def pictures(
    splats: Iterable[Gaussians],
    cameras: Iterable[Camera],
    *,
    background: Colour | None = (1.0, 1.0, 1.0),
    device: str = "cpu",
) -> Iterator[NDArray[np.uint8]]:
    """The picture of each splat before its camera, as ``render`` makes it, in order.

    The next splat is made while this one is drawn, unless that is large; one that stands
    before several cameras, one after the other, is prepared once.
    """
    coming = ahead(_all_arrays(splats), size=_bytes)
    for camera in cameras:
        (arrays,) = islice(coming, 1)
        picture = _picture(arrays, camera, background, device)
        del arrays  # before the next but one is made, which may have its memory
        yield picture


def _bytes(arrays: Arrays) -> int:
    return sum(array.nbytes for array in arrays)


def _all_arrays(splats: Iterable[Gaussians]) -> Iterator[Arrays]:
    # What held a splat or all of its arrays would keep the next one from its memory.
    shown: weakref.ref[Gaussians] | None = None
    for splat in splats:
        if shown is None or splat is not shown():
            arrays = renderer_arrays(splat)
            shown, activated = weakref.ref(splat), arrays[2:4]
        else:
            arrays = _arrays(splat, *activated)
        yield arrays
        del splat, arrays


def _picture(
    arrays: Arrays, camera: Camera, background: Colour | None, device: str
) -> NDArray[np.uint8]:
    rgb, alpha, _ = rasterize(
        *arrays,
        camera.viewmat,
        camera.K,
        camera.width,
        camera.height,
        background=background,
        device=device,
    )
    if background is None:
        rgb = np.where(alpha[..., None] > 0, rgb / np.maximum(alpha, 1e-8)[..., None], 0)
        rgb = np.concatenate([rgb, alpha[..., None]], axis=-1)
    # In place: what the system hands out anew for each frame costs more than the sums.
    rgb *= 255
    rgb += 0.5
    return np.asarray(np.clip(rgb, 0, 255, out=rgb).astype(np.uint8))


@one_thread()  # others would spin for a while, and take a core from the rasterizer
def renderer_arrays(gaussians: Gaussians) -> Arrays:
    """means, quats, scales, opacities and sh as ``renderer.rasterize`` takes them."""
    return _arrays(gaussians, _array(gaussians.scales), _array(gaussians.opacities))


def _arrays(gaussians: Gaussians, scales: Array, opacities: Array) -> Arrays:
    means, quats, sh = map(_array, (gaussians.means, gaussians.quats, gaussians.sh))
    return means, quats, scales, opacities, sh


def _array(field: torch.Tensor) -> Array:
    return field.detach().to("cpu", torch.float32).contiguous().numpy()


def bounds(*splats: Gaussians) -> Bounds:
    """The sphere round all of ``splats``, so that a camera stays put while one becomes another."""
    return bounds_of(
        np.concatenate([one.means.cpu().numpy() for one in splats]),
        np.concatenate([one.opacities.cpu().numpy() for one in splats]),
        np.concatenate([one.scales.cpu().numpy() for one in splats]),
    )


def upright(gaussians: Gaussians, up: str | None = None) -> str:
    """The axis to hold up in a picture: ``up`` if given, what the splat says, else y.

    No camera holds x up: a splat that says so is shown as one that says nothing.
    """
    return up or (gaussians.up if gaussians.up in UPRIGHT else None) or "y"


def turntable(
    around: Bounds,
    count: int,
    *,
    degrees: float = SWING,
    azimuth: float = 0.0,
    elevation: float = 0.0,
    up: str = "y",
    size: tuple[int, int] = (512, 512),
) -> list[Camera]:
    """``count`` cameras that loop: a full circle for ``degrees`` of 360 or more, else a swing.

    Args:
        around: the sphere to keep in view.
        count: how many cameras.
        degrees: how far the camera swings to each side of ``azimuth``.
        azimuth: degrees from the front, where the move begins.
        elevation: degrees above the object.
        up: the world axis that points up.
        size: width and height in pixels.
    """
    phase = [i / count for i in range(count)]
    if abs(degrees) >= 360:
        offsets = [degrees * p for p in phase]
    else:
        offsets = [degrees * math.sin(2 * math.pi * p) for p in phase]
    width, height = size
    azimuths = [azimuth + offset for offset in offsets]
    return orbit(around, azimuths, elevation=elevation, up=up, width=width, height=height)


def there_and_back(count: int, start: float = 0.0, end: float = 1.0) -> list[float]:
    """``count`` times that go from ``start`` to ``end`` and back, lingering at both; they loop."""
    swing = [(1 - math.cos(2 * math.pi * i / count)) / 2 for i in range(count)]
    # At the half-way frame the cosine is exact only up to rounding, and t = end is bit-exact.
    swing = [1.0 if 2 * i == count else s for i, s in enumerate(swing)]
    return [start + (end - start) * s for s in swing]
