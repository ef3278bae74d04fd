"""Paths: what splats go through along a flow, worked out at knots of time.

Between the knots k/KNOTS everything lies on the cubics through them with the slopes of neighbours,
which are linear in the knots: four weights tell a moment.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from renderer.cpp.threads import together
from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians
from splatmorph.morph.covariance import carried_shapes
from splatmorph.morph.native import shapes
from splatmorph.steady import one_thread

KNOTS = 8
"""Moments a unit of t at which centers and shapes are worked out."""

BLOCK = 1 << 12
"""Splats whose Jacobians are held at a time."""

TURN = 32767
"""The length of quaternions that are kept as 16-bit integers: colours bear it."""


@dataclass(frozen=True)
class Drift:
    """What becomes of splats beyond the flow, each of it times |t|: all at the other end."""

    offset: Tensor
    """(n, 3) world units, added to where the flow takes the centers."""
    slope: Tensor
    """(n, 3, 3) the derivative of the offset by the centers at t = 0, added to that of the flow."""
    sh: Tensor
    """(n, k, 3) added to the coefficients of the colours, before they turn with their splats."""


class Path(NamedTuple):
    """What changes of n splats, at the start and at k knots after it."""

    start: Tensor
    """(n, c)"""
    knots: Tensor
    """(k, n, c), of the start's dtype, or 16-bit integers where that is enough."""

    def at(self, weights: Tensor) -> Tensor:
        """(n, c) for the ``weights`` (k,) of the knots; the start's is 1 minus their sum."""
        knots = self.knots.to(self.start).flatten(1)
        moved = (weights.to(self.start) @ knots).view(self.start.shape)
        return torch.add(moved, self.start, alpha=1 - float(weights.sum()))


@dataclass(frozen=True)
class Paths:
    """What splats go through in one direction of time, at the knots about some ways."""

    knots: int
    """So many there are beyond the start."""
    kept: Sequence[int]
    """Those that are held, ascending."""
    held: Mapping[str, Path]
    """By the name of what changes: centers, quaternions, log scales where they do, and ``turns``
    for colours that turn: the rotation P as a quaternion of length ``TURN``."""

    def about(self, way: float) -> tuple[dict[str, Path], Tensor]:
        """The knots about a ``way`` in units of t, at most four, and their weights."""
        near = _near(way, self.knots)
        first = self.kept.index(near.start)
        rows = slice(first, first + len(near))
        paths = {name: Path(path.start, path.knots[rows]) for name, path in self.held.items()}
        return paths, _weights(way, self.knots)[near.start : near.stop]


def paths_of(
    gaussians: Gaussians,
    flow: Flow,
    sign: int,
    ways: Sequence[float],
    *,
    stretch: bool,
    drift: Drift | None = None,
) -> Paths:
    """The paths of splats in the direction ``sign`` of time, for some ``ways`` > 0.

    One knot more than they reach is worked out, for the slope there; but within one unit of t none
    is beyond it, where baselines that are no flows end.
    """
    reach = max(ways)
    last = max(2, math.ceil(reach * KNOTS) + 1)
    last = min(last, KNOTS) if reach <= 1 else last
    stops = [sign * k / KNOTS for k in range(1, last + 1)]
    kept = sorted({knot for way in ways for knot in _near(way, last)})
    quats, log_scales = gaussians.quats, gaussians.log_scales
    starts = {"means": gaussians.means, "quats": quats}
    if stretch:
        starts["log_scales"] = log_scales
    if gaussians.sh_degree:
        starts["turns"] = quats.new_tensor([TURN, 0, 0, 0]).expand_as(quats)
    dtypes = {"turns": torch.int16}
    held = {
        name: Path(start, start.new_empty(len(kept), *start.shape, dtype=dtypes.get(name)))
        for name, start in starts.items()
    }

    def work_out(block: slice, means: Tensor, jacobians: Tensor) -> None:
        if drift is not None:
            way = jacobians.new_tensor(stops).abs()[:, None, None]
            means = means + way * drift.offset[block].to(means)
            jacobians = jacobians + way[..., None] * drift.slope[block].to(jacobians)
        own = quats[block], log_scales[block], jacobians
        takes = shapes.takes(quats, jacobians, stretch=stretch)
        carried = (shapes.carried_shapes if takes else carried_shapes)(*own, stretch=stretch)
        found = dict(zip(("quats", "log_scales", "turns"), carried, strict=True), means=means)
        found["turns"].mul_(TURN).round_()
        for name, path in held.items():
            for knot, row in zip(kept, path.knots, strict=True):
                row[block] = found[name][knot - 1]

    for_each_block(work_out, flow, gaussians.means, stops)
    return Paths(last, kept, held)


def for_each_block(
    work: Callable[[slice, Tensor, Tensor], None],
    flow: Flow,
    points: Tensor,
    times: Sequence[float],
) -> None:
    """``work`` on Φ and ∂Φ/∂x at ``points`` (n, 3) after k ``times``, on torch's threads.

    It gets which points they are, (k, m, 3) and (k, m, 3, 3).
    """
    threads = torch.get_num_threads()

    @torch.no_grad()
    def share(number: int) -> None:
        for begin in range(number * BLOCK, len(points), threads * BLOCK):
            block = slice(begin, begin + BLOCK)
            work(block, *flow.trajectory_jacobian(points[block], times))

    # A block stays in the cache of the core that works on it.
    with one_thread():
        together(share, threads if len(points) > BLOCK else 1)


def _near(way: float, knots: int) -> range:
    """The knots about a way, of 1 to so many."""
    left = min(int(way * KNOTS), knots - 1)
    return range(max(left - 1, 1), min(left + 2, knots) + 1)


def _weights(way: float, knots: int) -> Tensor:
    """(1 + knots,) float64, how much each knot counts."""
    place = way * KNOTS
    left = min(int(place), knots - 1)
    s = place - left
    # The cubic is linear in the knots: its weights are its values for unit vectors.
    units = torch.eye(1 + knots, dtype=torch.float64)
    (slopes,) = torch.gradient(units, dim=0, edge_order=2)
    rise = units[left + 1] - units[left]
    bend = (1 - s) * (slopes[left] - rise) + s * (rise - slopes[left + 1])
    return units[left] + s * (rise + (1 - s) * bend)
