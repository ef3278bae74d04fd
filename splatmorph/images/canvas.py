"""Canvas: the rectangle of the plane that a picture covers."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Canvas:
    """Where the pixels of a ``width`` × ``height`` picture lie in the plane.

    The plane has x to the right and y up. Every picture is centered on the origin and scaled so
    that its longer side runs from -1 to 1: two pictures of different sizes lie on each other
    without being stretched. Pixel coordinates (x, y) are continuous, (0, 0) the upper left
    corner of the picture, so the center of the first pixel is at (0.5, 0.5).
    """

    width: int
    height: int

    @property
    def pixel(self) -> float:
        """The side of a pixel in world units."""
        return 2 / max(self.width, self.height)

    @property
    def half(self) -> tuple[float, float]:
        """Half the width and half the height in world units; the longer is 1."""
        return self.width * self.pixel / 2, self.height * self.pixel / 2

    def scaled(self, scale: float) -> Canvas:
        """A canvas of so many times the width and the height, a pixel at least."""
        return Canvas(*(max(1, round(side * scale)) for side in (self.width, self.height)))

    def to_world(self, pixels: Tensor) -> Tensor:
        """Pixel coordinates (..., 2) in the plane."""
        return (pixels - self._middle(pixels)) * self._step(pixels)

    def to_pixels(self, world: Tensor) -> Tensor:
        """Points of the plane (..., 2) in pixel coordinates."""
        return world / self._step(world) + self._middle(world)

    def centers(self) -> Tensor:
        """The pixel centers in the plane, (height, width, 2) float32."""
        x = torch.arange(self.width) + 0.5
        y = torch.arange(self.height) + 0.5
        return self.to_world(torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1))

    def border(self, per_side: int) -> Tensor:
        """Points on the border, ``per_side`` steps a side: (4 · per_side, 2) float64, world.

        One step a side gives the four corners.
        """
        steps = torch.arange(per_side, dtype=torch.float64) / per_side * 2 - 1
        edge = torch.ones_like(steps)
        sides = [(steps, edge), (edge, -steps), (-steps, -edge), (-edge, steps)]
        unit = torch.cat([torch.stack(side, dim=1) for side in sides])
        return unit * torch.tensor(self.half, dtype=torch.float64)

    def _middle(self, like: Tensor) -> Tensor:
        return torch.tensor([self.width / 2, self.height / 2], dtype=like.dtype)

    def _step(self, like: Tensor) -> Tensor:
        return torch.tensor([self.pixel, -self.pixel], dtype=like.dtype)
