"""Warps: where in each picture a pixel of the morph takes its colour from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from splatmorph.errors import OptionError
from splatmorph.flows import Conjugate, Flow, Node
from splatmorph.images.canvas import Canvas
from splatmorph.images.lattice import Lattice, LatticeMap, tabulated

EDGES = {"edge": "border", "reflect": "reflection", "zero": "zeros"}
"""What lies beyond a picture -> grid_sample's word: its last pixel, its mirror image, nothing."""

INTERPOLATIONS = ("bilinear", "bicubic")

SPACINGS = (32.0, 16.0, 8.0, 4.0, 2.0)
"""Pixels between the nodes of a lattice, as they are tried."""

PROBES = 1024
ENDS = (-1.0, 1.0)
TRUE_FLOWS = (Node, Conjugate)
"""The kinds that are the integral of their velocity; the baselines are not."""

MARGIN, FARTHEST = 1.1, 3.0
"""A table of velocities covers what the paths reach, and a tenth more, up to three canvases."""

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
class Route:
    """How the paths of a canvas's pixels are found, and how well."""

    flow: Flow
    """The flow itself, or a table of its velocity."""
    lattice: Lattice
    """Where the paths begin."""
    error: float
    """The largest distance to the flow's own positions found at t = ±1, in pixels."""


@dataclass(frozen=True)
class FlowWarp:
    """The inverse warp by a flow: at t the source is read at Φ(x, -t), the target at Φ(x, 1 - t).

    The paper's I^i(x, t) = I^i(Φ(x, i - t)). The flow is followed from the nodes of a lattice,
    once for all times, and interpolated between them; a flow that is the integral of its
    velocity is followed through a table of it. Lattice and table are the coarsest whose
    positions are within ``tolerance`` of the flow's own.
    """

    flow: Flow
    tolerance: float = 0.05
    """The largest error allowed, in pixels of the output."""
    _routes: dict[Canvas, Route] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def maps(self, canvas: Canvas, times: Sequence[float]) -> Iterator[tuple[PixelMap, PixelMap]]:
        """As ``Warp.maps``."""
        route = self.route(canvas)
        start = route.lattice.points.to(torch.float32)
        block = max(1, BLOCK // (2 * start.nbytes))
        for begin in range(0, len(times), block):
            part = times[begin : begin + block]
            both = [-t for t in part] + [1 - t for t in part]
            positions = route.flow.trajectory(start, both).unflatten(0, (2, len(part)))
            for source, target in zip(*positions, strict=True):
                yield LatticeMap(route.lattice, source), LatticeMap(route.lattice, target)

    def carry(self, points: Tensor, t: float) -> Tensor:
        """As ``Warp.carry``."""
        return self.flow(points, t)

    def route(self, canvas: Canvas) -> Route:
        """How this canvas is warped, found once.

        The error is measured at ``PROBES`` pixels drawn with a fixed seed. Where even the
        finest lattice misses the tolerance, the best is taken, with its error.
        """
        if canvas not in self._routes:
            self._routes[canvas] = self._find_route(canvas)
        return self._routes[canvas]

    def _find_route(self, canvas: Canvas) -> Route:
        generator = torch.Generator().manual_seed(0)
        x = torch.randint(canvas.width, (PROBES,), generator=generator)
        y = torch.randint(canvas.height, (PROBES,), generator=generator)
        probes = canvas.to_world(torch.stack([x, y], dim=1).to(torch.float64) + 0.5)
        exact = self.flow.trajectory(torch.cat([probes, canvas.border(4)]), ENDS)
        reach = float((exact.abs().amax((0, 1)) / torch.tensor(canvas.half)).max())
        reach = MARGIN * min(max(1.0, reach), FARTHEST)
        best: Route | None = None
        for flow, spacing in self._candidates(canvas, reach):
            lattice = Lattice(canvas, spacing)
            values = flow.trajectory(lattice.points.to(torch.float32), ENDS)
            missed = (lattice.at_pixels(values, x, y) - exact[:, :PROBES]).norm(dim=-1)
            route = Route(flow, lattice, float(missed.max()) / canvas.pixel)
            if best is None or route.error < best.error:
                best = route
            if best.error <= self.tolerance:
                break
        assert best is not None
        return best

    def _candidates(self, canvas: Canvas, reach: float) -> Iterator[tuple[Flow, float]]:
        if isinstance(self.flow, TRUE_FLOWS):
            for spacing in SPACINGS:
                yield tabulated(self.flow, canvas, spacing, reach), spacing
        if not isinstance(self.flow, Node):  # whose table is as good as its lattice
            for spacing in SPACINGS:
                yield self.flow, spacing


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
