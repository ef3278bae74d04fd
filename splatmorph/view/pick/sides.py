"""What can be clicked on: splats, and pictures as the plane case."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from renderer import Bounds, Camera, look_at
from renderer.cameras import UPRIGHT
from splatmorph.errors import OptionError
from splatmorph.images import Picture
from splatmorph.images.picture import FORMATS
from splatmorph.rendering import bounds, rasterize, render, renderer_arrays
from splatmorph.runs.inputs import Input
from splatmorph.runs.upright import standing_way
from splatmorph.view.page.coding import along_curve, one_block
from splatmorph.view.page.pack import first_camera, pack
from splatmorph.view.pick.book import Point, Ray, numbers
from splatmorph.view.pick.sights import SHARES, Seen, near_of, surface
from splatmorph.view.scene import Scene
from splatmorph.view.subject import thin

Array = NDArray[np.float64]

MOST_PIXELS = 4096
"""A side of a pane."""
SOLID = 0.6
"""Alpha from which a pixel is surface."""
NEAR_ENOUGH = 0.08
"""Radii within which a prediction is moved onto the surface."""
HIDDEN = 0.03
"""Radii behind the surface from which a mark is hidden."""
COARSE = 128
"""Pixels of the longer side of the depth picture by which marks are hidden and places found."""
PICTURES = tuple(f".{name.lower()}" for name in (*FORMATS, "JPG", "TIF", "PGM"))
"""Extensions by which an input is a picture."""


class Side(Protocol):
    """One input, in its own coordinates."""

    path: Path
    dim: int
    center: Array
    """(dim,)"""
    radius: float

    def facts(self) -> Mapping[str, Any]:
        """What the page is told at first, JSON."""

    def seen(self, camera: Camera, x: float, y: float) -> Seen | None:
        """The surface point under a pixel."""

    def seen_at(self, point: Array, camera: Camera) -> Seen | None:
        """The click that would hit a point: what was suggested is clicked by a key."""

    def onto_surface(self, point: Array, camera: Camera) -> Array:
        """The surface point before or behind ``point`` as a camera sees it, where it is near."""

    def hidden(self, points: Sequence[Point], camera: Camera) -> list[bool]:
        """Whether each point lies behind the surface."""

    def places(self, camera: Camera) -> Array:
        """(n, dim) points of the surface that the camera sees well."""


class SplatSide:
    """A splat, whole: what the page shows of it may be thinned out."""

    dim = 3

    def __init__(self, loaded: Input, most: int, up: str | None = None) -> None:
        self.path, self.gaussians = loaded.path, loaded.gaussians
        self.name = loaded.name
        self.up = up or standing_way(loaded.gaussians)[0]
        if self.up not in UPRIGHT:
            self.up = "y"
        self.arrays = renderer_arrays(loaded.gaussians)
        self.bounds: Bounds = bounds(loaded.gaussians)
        self.center, self.radius = self.bounds.center, self.bounds.radius
        self.most = most

    def facts(self) -> Mapping[str, Any]:
        """Its name, its place, and how it may stand."""
        ups = {
            name: dict(zip(("right", "up", "back"), axes.tolist(), strict=True))
            for name, axes in UPRIGHT.items()
        }
        shown = min(self.most, len(self.gaussians))
        return {
            "kind": "splat",
            "name": self.name,
            "center": self.center.tolist(),
            "radius": self.radius,
            "up": self.up,
            "ups": ups,
            "count": len(self.gaussians),
            "shown": shown,
        }

    @cached_property
    def kept(self) -> torch.Tensor:
        """Indices of the splats that the page shows, near ones side by side."""
        index = thin(self.gaussians, self.most)
        order = along_curve(self.gaussians.means[index].double().numpy())
        return index[torch.from_numpy(order)]

    @cached_property
    def payload(self) -> Mapping[str, Any]:
        """The splat as the page draws it."""
        return payload(Scene((self.gaussians,), (self.name,)), [self.kept], self.up)

    def seen(self, camera: Camera, x: float, y: float) -> Seen | None:
        """As ``Side`` says."""
        return surface(self.arrays, self.bounds, camera, x, y)

    def seen_at(self, point: Array, camera: Camera) -> Seen | None:
        """As ``Side`` says."""
        x, y, depth = _pixel(camera, point[None])[0]
        return self.seen(camera, float(x), float(y)) if depth > 0 else None

    def onto_surface(self, point: Array, camera: Camera) -> Array:
        """As ``Side`` says."""
        x, y, depth = _pixel(camera, point[None])[0]
        if depth <= 0 or not (0 <= x < camera.width and 0 <= y < camera.height):
            return point
        found = self.seen(camera, float(x), float(y))
        if found is None:
            return point
        near = np.linalg.norm(np.array(found.point) - point) < NEAR_ENOUGH * self.radius
        return np.array(found.point) if near else point

    def seen_from_outside(self, point: Array) -> Array:
        """The surface point near ``point`` as seen from outside, straight above it."""
        outward = point - self.center
        outward /= max(float(np.linalg.norm(outward)), 1e-12)
        first = first_camera(Scene((self.gaussians,), (self.name,)), self.up, 256)
        distance = float(np.linalg.norm(first.position - self.center))
        return self.onto_surface(point, _looking_along(first, point, outward, distance))

    def hidden(self, points: Sequence[Point], camera: Camera) -> list[bool]:
        """As ``Side`` says."""
        if not points:
            return []
        small, _, depth = self._depth(camera)
        pixels = _pixel(small, np.array(points))
        behind = []
        for x, y, z in pixels:
            inside = 0 <= x < small.width and 0 <= y < small.height and z > 0
            at = float(depth[int(y), int(x)]) if inside else 0.0
            behind.append(at > 0 and z > at + HIDDEN * self.radius)
        return behind

    def places(self, camera: Camera) -> Array:
        """As ``Side`` says."""
        small, alpha, depth = self._depth(camera)
        solid = alpha > SOLID
        for axis in (0, 1):
            for shift in (-2, 2):
                solid &= np.roll(alpha, shift, axis) > SOLID
                far = np.abs(np.roll(depth, shift, axis) - depth)
                solid &= far < 6 * depth / small.K[0, 0]
        solid[:2] = solid[-2:] = solid[:, :2] = solid[:, -2:] = False
        y, x = np.nonzero(solid)
        K = small.K
        rays = np.stack([(x + 0.5 - K[0, 2]) / K[0, 0], (y + 0.5 - K[1, 2]) / K[1, 1]], 1)
        seen = np.concatenate([rays, np.ones_like(rays[:, :1])], 1) * depth[y, x][:, None]
        return np.asarray((seen - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3])

    def _depth(self, camera: Camera) -> tuple[Camera, NDArray[np.float32], NDArray[np.float32]]:
        shrink = min(1.0, COARSE / max(camera.width, camera.height))
        width, height = (max(8, round(side * shrink)) for side in (camera.width, camera.height))
        K = camera.K.copy()
        K[0] *= width / camera.width
        K[1] *= height / camera.height
        small = Camera(camera.viewmat, K, width, height)
        _, alpha, depth = rasterize(
            *self.arrays,
            camera.viewmat,
            K,
            width,
            height,
            near=near_of(camera, self.bounds),
            depth="surface",
            surface_share=SHARES[1],
        )
        return small, alpha, depth

    def drawn(self, camera: Camera) -> bytes:
        """What the rasterizer draws, a JPEG."""
        return jpeg(render(self.gaussians, camera))


class PictureSide:
    """A picture; its plane has y up, and the longer side runs from -1 to 1."""

    dim = 2

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.stem
        self.picture = Picture.read(path)
        self.center, self.radius = np.zeros(2), 1.0

    def facts(self) -> Mapping[str, Any]:
        """Its name and size."""
        canvas = self.picture.canvas
        return {
            "kind": "picture",
            "name": self.name,
            "center": [0.0, 0.0],
            "radius": 1.0,
            "half": list(canvas.half),
            "width": canvas.width,
            "height": canvas.height,
        }

    @cached_property
    def png(self) -> bytes:
        """The pixels for the page."""
        stream = io.BytesIO()
        Image.fromarray(self.picture.with_channels(3).rgb()).save(stream, "PNG", compress_level=1)
        return stream.getvalue()

    def seen(self, camera: Camera, x: float, y: float) -> Seen | None:
        """As ``Side`` says: where the pixel is, if that is on the picture."""
        K = camera.K
        point = ((x - K[0, 2]) / K[0, 0], -(y - K[1, 2]) / K[1, 1])
        half = self.picture.canvas.half
        if any(abs(value) > most for value, most in zip(point, half, strict=True)):
            return None
        return Seen(point, Ray((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), 0.0)

    def seen_at(self, point: Array, camera: Camera) -> Seen | None:
        """As ``Side`` says."""
        K = camera.K
        return self.seen(camera, K[0, 0] * point[0] + K[0, 2], -K[1, 1] * point[1] + K[1, 2])

    def onto_surface(self, point: Array, camera: Camera) -> Array:
        """As ``Side`` says: into the picture."""
        return self.seen_from_outside(point)

    def seen_from_outside(self, point: Array) -> Array:
        """The point, on the picture."""
        half = np.array(self.picture.canvas.half)
        return np.clip(point, -half, half)

    def hidden(self, points: Sequence[Point], camera: Camera) -> list[bool]:
        """As ``Side`` says: none."""
        return [False] * len(points)

    def places(self, camera: Camera) -> Array:
        """As ``Side`` says: a lattice over the picture."""
        x, y = (np.linspace(-0.9 * half, 0.9 * half, 40) for half in self.picture.canvas.half)
        return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)


def payload(scene: Scene, kept: Sequence[torch.Tensor], up: str) -> dict[str, Any]:
    """A scene as the page's script unpacks it."""
    packed = pack(scene, kept, up)
    tables, block = one_block(packed.tables, level=1)
    splats = [{"name": name, "count": len(k)} for name, k in zip(scene.names, kept, strict=True)]
    return {**packed.facts, "tables": tables, "splats": splats, "payload": block}


def jpeg(pixels: NDArray[np.uint8]) -> bytes:
    """The picture for a page that can't draw by itself."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "JPEG", quality=88)
    return stream.getvalue()


def camera_from(stored: Any) -> Camera:
    """The camera of a pane as the page sends it: rows, shift, focal, middle, width, height.

    Raises:
        OptionError: it is none.
    """
    try:
        viewmat = np.eye(4)
        viewmat[:3, :3] = [numbers(row, 3) for row in stored["rows"]]
        viewmat[:3, 3] = numbers(stored["shift"], 3)
        cx, cy = numbers(stored["middle"], 2)
        focal, width, height = numbers([stored[key] for key in ("focal", "width", "height")], 3)
    except (KeyError, TypeError, ValueError) as error:
        raise OptionError(f"expected a camera ({error})") from error
    turn = viewmat[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-3 or focal <= 0:
        raise OptionError("the camera's axes are no rotation, or its focal length is not positive")
    if not (1 <= width <= MOST_PIXELS and 1 <= height <= MOST_PIXELS):
        raise OptionError(f"the pane is {width:g}x{height:g}, expected 1 to {MOST_PIXELS} a side")
    K = np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1.0]])
    return Camera(viewmat, K, int(width), int(height))


def _pixel(camera: Camera, points: Array) -> Array:
    """(n, 3) pixel coordinates and depth."""
    seen = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    depth = np.where(seen[:, 2] > 0, seen[:, 2], 1.0)
    pixels = seen[:, :2] / depth[:, None] * camera.K[[0, 1], [0, 1]] + camera.K[:2, 2]
    return np.concatenate([pixels, seen[:, 2:]], 1)


def _looking_along(like: Camera, point: Array, outward: Array, distance: float) -> Camera:
    up = -like.viewmat[1, :3]
    if abs(float(up @ outward)) > 0.95:
        up = like.viewmat[2, :3]
    return Camera(look_at(point + distance * outward, point, up), like.K, like.width, like.height)
