"""The motion of one morph as a page carries it: moves and shapes at a few moments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from splatmorph.gaussians import Gaussians
from splatmorph.morph import Morph
from splatmorph.morph.covariance import polar_rotation
from splatmorph.morph.paths import Drift
from splatmorph.view.knots import FINEST, fewest_knots, knot_times, knot_weights
from splatmorph.view.page.coding import Table

TOLERANCE = 0.5
"""Pixels a path between its knots may be off, before rounding."""
STEP = 1 / 16
"""Pixels, to which moves are rounded."""
SAMPLE = 4096

Array = NDArray[np.float64]


class Motion:
    """The paths of both sides of a morph, at the fewest knots that keep them true.

    Arguments:
        sides: the splats at either end, as they are shown, in the source's place.
        drifts: what becomes of them beyond the flow.
        pixel: world units that a pixel of the picture measures.
    """

    def __init__(
        self,
        morph: Morph,
        sides: tuple[Gaussians, Gaussians],
        drifts: Sequence[Drift],
        pixel: float,
    ) -> None:
        self.flow = morph.flow
        self.sides, self.drifts = sides, drifts
        self.covariance = morph.covariance
        self.pixel = pixel
        finest = knot_times(FINEST)
        paths = [
            self.paths(side.means[:: max(1, len(side) // SAMPLE)], i, finest)
            for i, side in enumerate(sides)
        ]
        tolerance = TOLERANCE * pixel
        self.times = knot_times(fewest_knots(np.concatenate(paths, axis=1), tolerance))

    @torch.no_grad()
    def paths(self, points: torch.Tensor, side: int, times: Array) -> Array:
        """(T, m, 3) where points of the source (side 0) or target (1) are at ``times``."""
        moved = self.flow.trajectory(points, (times - side).tolist())
        return np.asarray(moved.double().numpy(force=True))

    def landmarks(self, points: torch.Tensor, side: int) -> list[list[list[float]]]:
        """k landmarks × knots × 3."""
        return [path.tolist() for path in self.paths(points, side, self.times).swapaxes(0, 1)]

    def moves(self) -> tuple[Table, Array]:
        """(n, 3 · (knots - 1)) from each splat's own end to the other knots, and their (3,) step.

        Neighbours move alike, and a path bends little from knot to knot.
        """
        found = []
        for i, side in enumerate(self.sides):
            paths = self.paths(side.means, i, self._ways(i))
            moved = (paths - side.means.double().numpy(force=True)).swapaxes(0, 1)
            offset = self.drifts[i].offset.double().numpy(force=True)
            found.append(moved + np.abs(self._ways(i) - i)[:, None] * offset[:, None])
        moves = np.concatenate(found)
        coarsest = np.abs(moves).max(axis=(0, 1), initial=0) / 32767
        step = np.maximum(coarsest, STEP * self.pixel)
        rounded = np.rint(moves / step).astype(np.int16)
        return Table(
            rounded.reshape(len(moves), 3 * (len(self.times) - 1)), stride=3, times=2
        ), step

    @torch.no_grad()
    def shapes(self) -> tuple[Table, float]:
        """(n, 9 · (knots - 1)) what each shape is multiplied by, less the identity, and its step.

        Columns first, as shaders take them. The wildest 1 ‰ are cut. Empty where shapes stay.
        """
        if self.covariance == "fixed":
            return Table(np.empty((0, 9), np.int8)), 0.0
        found = []
        for i, side in enumerate(self.sides):
            times = (self._ways(i) - i).tolist()
            flowed = self.flow.trajectory_jacobian(side.means, times)[1]
            ways = flowed.new_tensor(times).abs()[:, None, None, None]
            shapes = (flowed + ways * self.drifts[i].slope.to(flowed)).flatten(0, 1)
            if self.covariance == "rotate":
                shapes = polar_rotation(shapes.permute(1, 2, 0)).permute(2, 0, 1)
            found.append(shapes.unflatten(0, (len(times), -1)).transpose(0, 1))
        deforms = torch.cat(found).double().numpy(force=True) - np.eye(3)
        widest = np.abs(deforms).max(axis=(1, 2, 3), initial=0)
        step = max(float(np.quantile(widest, 0.999)), 1e-30) / 127
        columns = deforms.swapaxes(-1, -2) / step
        rounded = np.rint(columns.clip(-127, 127)).astype(np.int8)
        return Table(
            rounded.reshape(len(rounded), 9 * (len(self.times) - 1)), stride=9, times=1
        ), step

    def error(self, moves: Table, step: Array) -> float:
        """The largest miss of the stored moves half way between the knots, pixels."""
        checks = (self.times[1:] + self.times[:-1]) / 2
        kept_moves = moves.values.astype(float).reshape(-1, len(self.times) - 1, 3) * step
        first = len(self.sides[0])
        worst = 0.0
        for i, (side, kept) in enumerate(
            zip(self.sides, np.split(kept_moves, [first]), strict=True)
        ):
            every = max(1, len(side) // SAMPLE)
            start, kept = side.means[::every], kept[::every]
            truth = self.paths(start, i, checks) - start.double().numpy(force=True)
            offset = self.drifts[i].offset[::every].double().numpy(force=True)
            truth = truth + np.abs(checks - i)[:, None, None] * offset
            for t, moved in zip(checks, truth, strict=True):
                weights = knot_weights(self.times, t)
                weights = weights[1:] if i == 0 else weights[:-1]
                missed = np.einsum("k,nkd->nd", weights, kept) - moved
                worst = max(worst, float(np.linalg.norm(missed, axis=1).max(initial=0)))
        return worst / self.pixel

    def _ways(self, side: int) -> Array:
        """The knots away from a side's own end."""
        return self.times[1:] if side == 0 else self.times[:-1]
