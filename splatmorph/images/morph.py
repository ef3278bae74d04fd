"""ImageMorph: two pictures and a warp, ready to be looked at for any t."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from torch import Tensor

from splatmorph.images.blend import Blend, linear
from splatmorph.images.canvas import Canvas
from splatmorph.images.picture import Picture
from splatmorph.images.warp import PixelMap, Warp, sample


@dataclass(frozen=True)
class ImageMorph:
    """The pictures between ``source`` (t = 0) and ``target`` (t = 1).

    Beyond [0, 1] the warp goes on and the blend stays at its end: a caricature.
    """

    source: Picture
    target: Picture
    warp: Warp
    canvas: Canvas | None = None
    """What the morph shows, and its resolution; None for the source's."""
    blend: Blend = linear
    interpolation: str = "bilinear"
    """How the pictures are read between their pixels, one of ``INTERPOLATIONS``."""
    edge: str = "edge"
    """What is read beyond them, one of ``EDGES``."""

    @property
    def output(self) -> Canvas:
        """The canvas of the frames."""
        return self.canvas or self.source.canvas

    def at(self, t: float) -> Picture:
        """The picture at t, float32. At 0 on the source's own canvas, it is the source."""
        return next(self.sequence([t]))

    def sequence(self, times: Sequence[float]) -> Iterator[Picture]:
        """The pictures at all times, the warp followed once for the whole sequence."""
        for t, maps in zip(times, self.warp.maps(self.output, times), strict=True):
            end = self.source if t == 0 else self.target if t == 1 else None
            if end is not None and end.canvas == self.output:
                # The identity warp: no rounding may touch the picture.
                yield end.with_channels(self._channels).as_float()
            else:
                yield Picture.from_planes(self._frame(t, *maps))

    def _frame(self, t: float, source: PixelMap, target: PixelMap) -> Tensor:
        if t <= 0:
            return self._side(0, source)
        if t >= 1:
            return self._side(1, target)
        return self.blend(self._side(0, source), self._side(1, target), t)

    def _side(self, side: int, where: PixelMap) -> Tensor:
        planes, own = self._sides[side]
        return sample(planes, own, where, self.output, self.interpolation, self.edge)

    @property
    def _channels(self) -> int:
        return max(self.source.channels, self.target.channels)

    @cached_property
    def _sides(self) -> list[tuple[Tensor, Canvas]]:
        sides = []
        for picture in (self.source, self.target):
            planes = picture.with_channels(self._channels).planes(self.output)
            sides.append((planes, Canvas(planes.shape[2], planes.shape[1])))
        return sides
