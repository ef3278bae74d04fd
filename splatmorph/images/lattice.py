"""Lattice: a smooth function of the plane from its values a few pixels apart."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.interpolate import CubicSpline
from torch import Tensor, nn
from torch.nn.functional import grid_sample

from splatmorph.flows import Flow, Node
from splatmorph.flows.node import DEFAULT_STEPS
from splatmorph.images.canvas import Canvas

FINER = 4
"""Cells of a table for one of the lattice that it is made from: there, linear is enough."""


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
        """The nodes in the plane, (down · across, 2) float64."""
        x, _, y, _ = self._axes
        nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return self.canvas.to_world(torch.from_numpy(nodes))

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


class VelocityTable(nn.Module):
    """A velocity field looked up: v(x) of ``flow`` over a canvas, world units.

    v is asked on a lattice of ``spacing`` pixels, splined to cells ``FINER`` times smaller and
    read bilinearly there; so a path costs the same for every field, however dear. The table is
    ``reach`` times the canvas, for paths that leave the picture and come back.
    """

    def __init__(self, flow: Flow, canvas: Canvas, spacing: float, reach: float) -> None:
        super().__init__()
        cells = reach * FINER / spacing
        own = Canvas(math.ceil(canvas.width * cells), math.ceil(canvas.height * cells))
        lattice = Lattice(own, FINER)
        velocities = flow.velocity(lattice.points * reach).to(torch.float32)
        self.table = lattice.interpolate(velocities).permute(2, 0, 1)[None].contiguous()
        self.extent = torch.tensor([reach, -reach]) * torch.tensor(own.half)

    def forward(self, x: Tensor) -> Tensor:
        """v: (m, 2) -> (m, 2); beyond the table as on its border."""
        grid = (x.to(torch.float32) / self.extent)[None, None]
        found = grid_sample(self.table, grid, padding_mode="border", align_corners=False)
        return found[0, :, 0].T.to(x)


def tabulated(flow: Flow, canvas: Canvas, spacing: float, reach: float) -> Flow:
    """The same flow on a canvas and around it, by a table of its velocity; only for true flows."""
    table = VelocityTable(flow, canvas, spacing, reach)
    steps = flow.steps if isinstance(flow, Node) else DEFAULT_STEPS
    # Node asks of a field no more than to be called, as long as nobody asks for Jacobians.
    return Node(2, table, steps)  # type: ignore[arg-type]
