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
from splatmorph.flows import Flow
from splatmorph.geometry.similarity import Similarity
from splatmorph.images.canvas import Canvas
from splatmorph.images.lattice import Lattice, LatticeMap

EDGES = {"edge": "border", "reflect": "reflection", "zero": "zeros"}
"""What lies beyond a picture -> grid_sample's word: its last pixel, its mirror image, nothing."""

INTERPOLATIONS = ("bilinear", "bicubic")

SPACINGS = (32.0, 16.0, 8.0, 4.0, 2.0)
"""Pixels between the nodes of a lattice, as they are tried."""

PROBES = 2048

BLOCK = 1 << 28
"""Bytes of lattice positions held at once; a longer sequence is integrated in stretches."""

BAND = 64
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
class FlowWarp:
    """The inverse warp by a flow: at t the source is read at Φ(x, -t), the target at Φ(x, 1 - t).

    The paper's I^i(x, t) = I^i(Φ(x, i - t)); with a frame S, in which the target stands, at
    Φ(S(t)⁻¹x, -t) and S∘Φ(S(t)⁻¹x, 1 - t). The flow is followed from the nodes of a lattice, where
    nothing stands apart once for all times, and interpolated between them. The lattice is the
    coarsest whose positions are within ``tolerance`` of the flow's own.
    """

    flow: Flow
    frame: Similarity = field(default_factory=lambda: Similarity.identity(2))
    """S: where the target stands, seen from the source."""
    tolerance: float = 0.05
    """The largest error allowed, in pixels of the output."""
    _lattices: dict[Canvas, tuple[Lattice, float]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def maps(self, canvas: Canvas, times: Sequence[float]) -> Iterator[tuple[PixelMap, PixelMap]]:
        """As ``Warp.maps``."""
        lattice, _ = self.lattice(canvas)
        block = 1
        if self.frame.is_identity:
            block = max(1, BLOCK // (2 * lattice.points.nbytes))
        for begin in range(0, len(times), block):
            for source, target in zip(
                *self.read(lattice.points, times[begin : begin + block]), strict=True
            ):
                yield LatticeMap(lattice, source), LatticeMap(lattice, target)

    def read(self, x: Tensor, times: Sequence[float]) -> tuple[Tensor, Tensor]:
        """Where source and target are read for points x (m, 2) at times of one S(t): (T, m, 2)."""
        start = self.frame.power(-times[0])(x)
        positions = self.flow.trajectory(start, [-t for t in times] + [1 - t for t in times])
        source, target = positions.unflatten(0, (2, len(times)))
        return source, self.frame(target)

    def carry(self, points: Tensor, t: float) -> Tensor:
        """As ``Warp.carry``."""
        return self.frame.power(t)(self.flow(points, t))

    def lattice(self, canvas: Canvas) -> tuple[Lattice, float]:
        """The lattice for a canvas, found once, and its largest error in pixels at t = ±1.

        The error is measured at ``PROBES`` pixels drawn with a fixed seed. Where even the
        finest lattice misses the tolerance it is taken all the same.
        """
        if canvas not in self._lattices:
            self._lattices[canvas] = self._find_lattice(canvas)
        return self._lattices[canvas]

    def _find_lattice(self, canvas: Canvas) -> tuple[Lattice, float]:
        generator = torch.Generator().manual_seed(0)
        x = torch.randint(canvas.width, (PROBES,), generator=generator)
        y = torch.randint(canvas.height, (PROBES,), generator=generator)
        exact = self._farthest(canvas.to_world(torch.stack([x, y], dim=1) + 0.5))
        for spacing in SPACINGS:
            lattice = Lattice(canvas, spacing)
            found = lattice.at_pixels(self._farthest(lattice.points), x, y)
            error = float((found - exact).norm(dim=-1).max()) / canvas.pixel
            if error <= self.tolerance:
                break
        return lattice, error

    def _farthest(self, x: Tensor) -> Tensor:
        """Where the target is read at t = 0 and the source at t = 1, after all of the way."""
        return torch.stack([self.read(x, [0.0])[1][0], self.read(x, [1.0])[0][0]])


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
