"""Lattice: a smooth function of the plane from its values a few pixels apart."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.interpolate import CubicSpline
from torch import Tensor

from splatmorph.images.canvas import Canvas


@dataclass(frozen=True)
class Lattice:
    """Nodes over a canvas, a few pixels apart, and the spline through values on them.

    The spline is the tensor product of cubic not-a-knot splines: exact for cubics, so the
    positions of an affine warp come out exact and those of a smooth one to fourth order.
    """

    canvas: Canvas
    spacing: float
    """Pixels between nodes, at most."""

    def _axis(self, pixels: int) -> tuple[np.ndarray, Tensor]:
        nodes = np.linspace(0, pixels, max(4, math.ceil(pixels / self.spacing) + 1))
        spline = CubicSpline(nodes, np.eye(len(nodes)))
        weights = spline(np.arange(pixels) + 0.5)
        return nodes, torch.from_numpy(weights).to(torch.float32)

    @cached_property
    def _axes(self) -> tuple[np.ndarray, Tensor, np.ndarray, Tensor]:
        return *self._axis(self.canvas.width), *self._axis(self.canvas.height)

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Nodes down and across."""
        return len(self._axes[2]), len(self._axes[0])

    @cached_property
    def points(self) -> Tensor:
        """The nodes in the plane, (down · across, 2) float32."""
        x, _, y, _ = self._axes
        nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return self.canvas.to_world(torch.from_numpy(nodes)).to(torch.float32)

    def interpolate(self, values: Tensor, first: int = 0, last: int | None = None) -> Tensor:
        """Values (down · across, 2) float32 on the nodes -> on the pixels of some rows.

        Returns:
            (last - first, width, 2) float32, for the rows first ≤ y < last.
        """
        _, columns, _, rows = self._axes
        down, across = self.shape
        part = rows[first:last] @ values.reshape(down, -1)
        return torch.einsum("xw,ywc->yxc", columns, part.view(-1, across, 2))

    def at_pixels(self, values: Tensor, x: Tensor, y: Tensor) -> Tensor:
        """Values (T, down · across, 2) float32 on the nodes -> (T, m, 2) on the m pixels (x, y)."""
        _, columns, _, rows = self._axes
        down, across = self.shape
        grid = values.view(len(values), down, across, 2)
        return torch.einsum("mh,thwc,mw->tmc", rows[y], grid, columns[x])


@dataclass(frozen=True)
class LatticeMap:
    """A map known on the nodes of a lattice."""

    lattice: Lattice
    values: Tensor
    """(down · across, 2) float32 world positions."""

    def band(self, first: int, last: int) -> Tensor:
        """As ``PixelMap.band``."""
        return self.lattice.interpolate(self.values, first, last)
