"""Warps: where in each picture a pixel of the morph takes its colour from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import torch
from scipy.interpolate import CubicSpline
from torch import Tensor
from torch.nn.functional import grid_sample

from splatmorph.errors import OptionError
from splatmorph.flows import Flow
from splatmorph.images.canvas import Canvas

EDGES = {"edge": "border", "reflect": "reflection", "zero": "zeros"}
"""What lies beyond a picture -> grid_sample's word: its last pixel, its mirror image, nothing."""

INTERPOLATIONS = ("bilinear", "bicubic")

COARSEST, FINEST = 32.0, 2.0
"""Pixels between the nodes of a lattice, the range that is tried."""

PROBES = 2048
BLOCK = 1 << 28
"""Bytes of lattice positions held at once; a longer sequence is integrated in stretches."""

BAND = 256
"""Rows warped at once: the positions of a band fit into a processor's cache."""


class PixelMap(Protocol):
    """Positions in the plane, one for every pixel of a canvas."""

    def band(self, first: int, last: int) -> Tensor:
        """Those of the rows first ≤ y < last: (last - first, width, 2) float32, world units."""
        ...


class Warp(Protocol):
    """A warp between two pictures: a flow, or what is compared with one."""

    def maps(self, canvas: Canvas, times: Sequence[float]) -> Iterator[tuple[PixelMap, PixelMap]]:
        """For every t: where the source, and where the target, is to be read."""
        ...

    def carry(self, points: Tensor, t: float) -> Tensor:
        """Where points (m, 2) of the source are at time t: (m, 2)."""
        ...


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

    def interpolate(self, values: Tensor, first: int, last: int) -> Tensor:
        """Values (down, across, 2) on the nodes -> on the pixels of some rows (rows, width, 2)."""
        _, columns, _, rows = self._axes
        down, across = self.shape
        part = rows[first:last] @ values.reshape(down, -1)
        return torch.einsum("xw,ywc->yxc", columns, part.view(-1, across, 2))


@dataclass(frozen=True)
class LatticeMap:
    """A map known on the nodes of a lattice."""

    lattice: Lattice
    values: Tensor
    """(down, across, 2) float32 world positions."""

    def band(self, first: int, last: int) -> Tensor:
        """As ``PixelMap.band``."""
        return self.lattice.interpolate(self.values, first, last)


@dataclass(frozen=True)
class FlowWarp:
    """The inverse warp by a flow: at t the source is read at Φ(x, -t), the target at Φ(x, 1 - t).

    The paper's I^i(x, t) = I^i(Φ(x, i - t)). The flow is followed from the nodes of a lattice,
    once for all times, and interpolated between them. The lattice is the coarsest whose
    positions are within ``tolerance`` of the integrated ones.
    """

    flow: Flow
    tolerance: float = 0.05
    """The largest error allowed, in pixels of the output."""

    def maps(self, canvas: Canvas, times: Sequence[float]) -> Iterator[tuple[PixelMap, PixelMap]]:
        """As ``Warp.maps``."""
        reach = sorted({s for t in times for s in (-t, 1 - t)}, key=abs)[-2:]
        lattice, _ = self.lattice(canvas, reach)
        block = max(1, BLOCK // (2 * lattice.points.nbytes))
        for begin in range(0, len(times), block):
            part = times[begin : begin + block]
            positions = self.flow.trajectory(
                lattice.points, [-t for t in part] + [1 - t for t in part]
            )
            values = positions.to(torch.float32).view(2, len(part), *lattice.shape, 2)
            for source, target in zip(*values, strict=True):
                yield LatticeMap(lattice, source), LatticeMap(lattice, target)

    def carry(self, points: Tensor, t: float) -> Tensor:
        """As ``Warp.carry``."""
        return self.flow(points, t)

    def lattice(
        self, canvas: Canvas, times: Sequence[float] = (-1.0, 1.0)
    ) -> tuple[Lattice, float]:
        """The lattice for this canvas and its largest error found at ``times``, in pixels.

        The error is that of the interpolation alone, against the flow at ``PROBES`` pixels
        drawn with a fixed seed. Where even the finest lattice misses the tolerance it is
        returned all the same, with its error.
        """
        generator = torch.Generator().manual_seed(0)
        x = torch.randint(canvas.width, (PROBES,), generator=generator)
        y = torch.randint(canvas.height, (PROBES,), generator=generator)
        probes = canvas.to_world(torch.stack([x, y], dim=1) + 0.5).to(torch.float64)
        exact = self.flow.trajectory(probes, times).to(torch.float32)
        spacing = COARSEST
        while True:
            lattice = Lattice(canvas, spacing)
            values = self.flow.trajectory(lattice.points, times).to(torch.float32)
            found = [
                lattice.interpolate(value.view(*lattice.shape, 2), 0, canvas.height)[y, x]
                for value in values
            ]
            error = float((torch.stack(found) - exact).norm(dim=-1).max()) / canvas.pixel
            if error <= self.tolerance or spacing <= FINEST:
                return lattice, error
            spacing /= 2


def sample(
    planes: Tensor,
    own: Canvas,
    where: PixelMap,
    canvas: Canvas,
    interpolation: str = "bilinear",
    edge: str = "edge",
) -> Tensor:
    """A picture read through a map: planes (c, h, w) on ``own`` -> (c, H, W) on ``canvas``.

    Raises:
        OptionError: an unknown interpolation or edge.
    """
    if interpolation not in INTERPOLATIONS:
        raise OptionError(
            f"interpolation '{interpolation}' is unknown: choose {' or '.join(INTERPOLATIONS)}"
        )
    if edge not in EDGES:
        raise OptionError(f"edge '{edge}' is unknown: choose one of {', '.join(EDGES)}")
    unit = torch.tensor([1 / own.half[0], -1 / own.half[1]])
    out = planes.new_empty(len(planes), canvas.height, canvas.width)
    rows = min(BAND, canvas.height)
    for begin in range(0, canvas.height, rows):
        first = min(begin, canvas.height - rows)
        grid = where.band(first, first + rows) * unit
        # grid_sample shares the work among threads by the batch, so the band becomes one.
        parts = math.gcd(rows, 8)
        read = grid_sample(
            planes.expand(parts, *planes.shape),
            grid.view(parts, rows // parts, canvas.width, 2),
            mode=interpolation,
            padding_mode=EDGES[edge],
            align_corners=False,
        )
        out[:, first : first + rows] = read.transpose(0, 1).flatten(1, 2)
    return out
