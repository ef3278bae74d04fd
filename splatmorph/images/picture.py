"""Picture: pixels as a file holds them, read whole and upright."""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image, ImageOps, UnidentifiedImageError
from torch import Tensor
from torch.nn.functional import interpolate

from splatmorph.errors import MissingExtraError, ReadError, TooLargeError
from splatmorph.images.canvas import Canvas
from splatmorph.io.reading import reading, require_file

Pixels = np.ndarray[Any, np.dtype[Any]]
DEPTHS: dict[np.dtype[Any], float] = {
    np.dtype(np.uint8): 255.0,
    np.dtype(np.uint16): 65535.0,
    np.dtype(np.float32): 1.0,
}
"""The value that means white, for each type a pixel may have."""

FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "PPM", "GIF")
"""Of Pillow's; others are rare, and some take any memory or run other programs."""
MOST_BYTES = 16
"""A pixel of an uncompressed file, room for what else it holds included."""
MOST_PIXELS = 50_000_000
"""Of a picture, unless the caller says otherwise: what phones take."""

BITS_PER_SAMPLE = 258
"""The TIFF tag."""


@dataclass(frozen=True)
class Picture:
    """A grey, RGB or RGBA picture; alpha is straight, not premultiplied.

    Raises ``ValueError`` where shape or type are others: a programming error.
    """

    pixels: Pixels
    """(height, width, 1 | 3 | 4) uint8, uint16, or float32 in [0, 1]."""

    def __post_init__(self) -> None:
        shape, kind = self.pixels.shape, self.pixels.dtype
        if len(shape) != 3 or shape[2] not in (1, 3, 4) or min(shape) < 1 or kind not in DEPTHS:
            raise ValueError(f"pixels are {kind} {shape}, expected (h, w, 1 | 3 | 4), 8 or 16 bit")

    @property
    def canvas(self) -> Canvas:
        """The rectangle of the plane that this picture covers."""
        return Canvas(self.pixels.shape[1], self.pixels.shape[0])

    @property
    def channels(self) -> int:
        """1 grey, 3 RGB, 4 RGBA."""
        return int(self.pixels.shape[2])

    def with_channels(self, channels: int) -> Picture:
        """The same picture with more channels: grey → RGB → RGBA; 3 drops the alpha."""
        pixels = self.pixels
        if self.channels == 1 and channels > 1:
            pixels = np.repeat(pixels, 3, axis=2)
        if channels == 4 and self.channels < 4:
            opaque = np.full_like(pixels[..., :1], DEPTHS[pixels.dtype])
            pixels = np.concatenate([pixels, opaque], axis=2)
        return Picture(pixels[..., :channels])

    def as_float(self) -> Picture:
        """The same picture, float32."""
        if self.pixels.dtype == np.float32:
            return self
        return Picture(self.pixels.astype(np.float32) / np.float32(DEPTHS[self.pixels.dtype]))

    def planes(self, canvas: Canvas | None = None) -> Tensor:
        """(channels, h, w) float32 in [0, 1], colours premultiplied by alpha.

        Where ``canvas`` has fewer pixels than the picture, it is reduced to that resolution
        with a filter wide enough that sampling it does not alias.
        """
        planes = torch.from_numpy(self.as_float().pixels).permute(2, 0, 1).contiguous()
        if self.channels == 4:
            planes[:3] *= planes[3]
        own = self.canvas
        if canvas is None or canvas.pixel <= own.pixel:
            return planes
        size = [max(1, round(side * own.pixel / canvas.pixel)) for side in (own.height, own.width)]
        return interpolate(planes[None], size, mode="bicubic", antialias=True)[0].clamp_(0, 1)

    @staticmethod
    def from_planes(planes: Tensor) -> Picture:
        """The float picture of premultiplied planes (channels, h, w)."""
        if len(planes) == 4:
            alpha = planes[3:]
            planes = torch.cat([planes[:3] / alpha.clamp_min(1e-6), alpha])
        return Picture(planes.clamp(0, 1).permute(1, 2, 0).contiguous().numpy())

    def eight_bit(self) -> Pixels:
        """(h, w, channels) uint8."""
        if self.pixels.dtype == np.uint8:
            return self.pixels
        values = torch.from_numpy(self.as_float().pixels) * 255
        return values.add_(0.5).clamp_(0, 255).to(torch.uint8).numpy()

    def rgb(self) -> Pixels:
        """(h, w, 3) uint8 as a video takes it; what is transparent shows black."""
        pixels = self.eight_bit()
        if self.channels == 4:
            weight = pixels[..., 3:].astype(np.uint16)
            return ((pixels[..., :3] * weight + 127) // 255).astype(np.uint8)
        return np.repeat(pixels, 3, axis=2) if self.channels == 1 else pixels

    @staticmethod
    def read(path: str | Path, max_pixels: int = MOST_PIXELS) -> Picture:
        """Read a still picture of one of ``FORMATS``, 8 or 16 bit, turned upright by its EXIF.

        Colours of 16 bits a channel are read by OpenCV, since Pillow would cut them to 8.

        Raises:
            ReadError: the file is missing, no picture, damaged or animated.
            TooLargeError: it has more than ``max_pixels`` pixels.
            MissingExtraError: 16-bit colours without OpenCV.
        """
        path = Path(path)
        require_file(path)
        with reading(path, "picture"), _no_limit_of_pillow():
            try:
                # From memory, where a length that lies finds no more than there is.
                data = _bytes(path, max_pixels)
                with Image.open(io.BytesIO(data), formats=FORMATS) as image:
                    return Picture(_decode(image, data, path, max_pixels))
            except UnidentifiedImageError as error:
                raise ReadError(
                    f"{path} is no picture that we can read: give one of {', '.join(FORMATS)}"
                ) from error


@contextlib.contextmanager
def _no_limit_of_pillow() -> Iterator[None]:
    """Ours is checked instead, which can be given; Pillow's warnings are of no use to anyone."""
    limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        Image.MAX_IMAGE_PIXELS = limit


def _bytes(path: Path, max_pixels: int) -> bytes:
    size = path.stat().st_size
    if size > MOST_BYTES * max_pixels:
        raise TooLargeError(
            f"{path} has {size:,} bytes, expected at most {MOST_BYTES * max_pixels:,}, which hold "
            f"{max_pixels:,} pixels: reduce it first, or raise `max_pixels`"
        )
    return path.read_bytes()


def _decode(image: Image.Image, data: bytes, path: Path, max_pixels: int) -> Pixels:
    width, height = image.size
    if width * height > max_pixels:
        raise TooLargeError(
            f"{path} has {width}x{height} pixels, expected at most {max_pixels:,} in all: reduce "
            "it first, or raise `max_pixels`"
        )
    # The second picture of an MPO, as cameras write it, is a preview.
    if getattr(image, "is_animated", False) and image.format != "MPO":
        raise ReadError(f"{path} is animated, expected one picture: extract one")
    if _bits(image, data) == 16 and image.mode not in ("I;16", "I;16B", "I;16L", "I"):
        return _turned(_read_deep_colour(data, path), image)
    if image.mode.startswith("I"):
        return _turned(_grey(image, path)[..., None], image)
    if image.mode == "F":
        raise ReadError(f"{path} holds floating-point values: convert it to 8 or 16 bits")
    mode = "L" if image.mode in ("1", "L") else "RGB"
    if image.has_transparency_data:
        mode = "RGBA"
    ImageOps.exif_transpose(image, in_place=True)
    pixels = np.array(image if image.mode == mode else image.convert(mode))
    return pixels[..., None] if mode == "L" else pixels


def _grey(image: Image.Image, path: Path) -> Pixels:
    """16 bits; what Pillow opens as 32-bit integers is 16-bit grey as well."""
    grey = np.array(image)
    if grey.min() < 0 or grey.max() > 65535:
        raise ReadError(f"{path} holds values beyond 16 bits: convert it to 16-bit grey")
    return grey.astype(np.uint16, copy=False)


def _bits(image: Image.Image, data: bytes) -> int:
    if image.format == "TIFF":
        return int(max(image.tag_v2.get(BITS_PER_SAMPLE, (8,))))  # type: ignore[attr-defined]
    if image.format == "PNG":
        return data[24]  # the bit depth of the first chunk, IHDR
    return 8


def _read_deep_colour(data: bytes, path: Path) -> Pixels:
    try:
        import cv2
    except ImportError as error:
        raise MissingExtraError("opencv-python-headless", "images", "16-bit colour") from error
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.dtype != np.uint16 or pixels.ndim != 3:
        raise ReadError(f"{path} is a 16-bit picture of a kind we can't read: convert it to PNG")
    order = [2, 1, 0, 3][: pixels.shape[2]]  # OpenCV's channels run blue, green, red
    return np.ascontiguousarray(pixels[..., order])


ORIENTATIONS: dict[int, Callable[[Pixels], Pixels]] = {
    2: lambda p: p[:, ::-1],
    3: lambda p: p[::-1, ::-1],
    4: lambda p: p[::-1],
    5: lambda p: p.swapaxes(0, 1),
    6: lambda p: p[::-1].swapaxes(0, 1),
    7: lambda p: p[::-1, ::-1].swapaxes(0, 1),
    8: lambda p: p[:, ::-1].swapaxes(0, 1),
}
"""EXIF orientation -> what turns the pixels upright."""


def _turned(pixels: Pixels, image: Image.Image) -> Pixels:
    # ImageOps turns 8-bit pictures; these come as arrays, beside it.
    turn = ORIENTATIONS.get(image.getexif().get(0x0112, 1))
    return np.ascontiguousarray(turn(pixels)) if turn else pixels
