"""The flow between two inputs as far as it is known: what it predicts, and who disagrees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from splatmorph.errors import SplatmorphError
from splatmorph.fitting import fit
from splatmorph.fitting.choice import LAMBDAS, SHEARS, Regression, standing_out
from splatmorph.flows import Flow, make_flow
from splatmorph.geometry.alignment import similarity_between
from splatmorph.geometry.similarity import Similarity
from splatmorph.landmarks import FEWEST, Landmarks

Array = NDArray[np.float64]

FEWEST_JUDGED = 6
"""Pairs from which each is told by the others."""
MOST_DOUBTED = 20
TOO_FAR, NOTABLE = 4.0, 0.02
"""A pair is in doubt that is so many times the usual surprise, and missed by this part of the
object's radius."""


@dataclass(frozen=True)
class Guide:
    """What finished pairs p, q (k, dim) say of the way between two inputs."""

    p: Tensor
    q: Tensor
    centers: tuple[Array, Array]
    """Of the objects (dim,)."""
    radii: tuple[float, float]
    flow: Flow | None
    """Φ in the source's frame; None for too few pairs."""
    frame: Similarity
    residuals: tuple[float | None, ...]
    """How far the others' spline misses each target point, world units."""
    doubtful: frozenset[int]
    """Which pairs the others contradict."""
    trouble: str | None
    """Why there is no flow though there are enough pairs."""

    @staticmethod
    def of(p: Tensor, q: Tensor, centers: tuple[Array, Array], radii: tuple[float, float]) -> Guide:
        """Fit a flow to the pairs, if they are enough."""
        dim, rest = p.shape[1], (p, q, centers, radii)
        unjudged: tuple[float | None, ...] = (None,) * len(p)
        untold = (None, Similarity.identity(dim), unjudged, frozenset[int]())
        if len(p) < FEWEST[dim]:
            return Guide(*rest, *untold, None)
        try:
            frame = similarity_between(p, q)
            back = frame.inverse()(q)
            flow = make_flow("node", dim=dim)
            fit(flow, Landmarks(p), Landmarks(back))
        except SplatmorphError as error:
            return Guide(*rest, *untold, str(error))
        if len(p) < FEWEST_JUDGED:
            return Guide(*rest, flow, frame, unjudged, frozenset(), None)
        a, b = flow.to_unit(p).double(), flow.to_unit(back).double()
        x, y, unit = (a + b) / 2, b - a, float(flow.scale) * frame.scale
        missed = Regression(x, y, SHEARS[1]).left_out(LAMBDAS[0]) * unit
        doubtful = standing_out(
            x,
            y,
            min(MOST_DOUBTED, len(x) - FEWEST_JUDGED),
            smoothing=LAMBDAS[0],
            times=TOO_FAR,
            missed=NOTABLE * radii[1] / unit,
        )
        return Guide(*rest, flow, frame, tuple(missed.tolist()), frozenset(doubtful), None)

    def predict(self, point: Array, side: int, turn: Array) -> Array:
        """Where the point (dim,) of the source (side 0) or the target (1) is on the other one.

        Without a flow it is moved, turned and scaled as the objects' bounds and their views are:
        ``turn`` (dim, dim) takes directions of this side's world to the other's.
        """
        if self.flow is not None:
            x = torch.from_numpy(point)[None]
            with torch.no_grad():
                if side == 0:
                    moved = self.frame(self.flow.forward(x, 1.0))
                else:
                    moved = self.flow.forward(self.frame.inverse()(x), -1.0)
            return np.asarray(moved[0].double().numpy())
        ends = (self.p, self.q) if side == 0 else (self.q, self.p)
        here, there = (end.mean(0).numpy() for end in ends)
        if not len(self.p):
            here, there = self.centers[side], self.centers[1 - side]
        grown = self.radii[1 - side] / self.radii[side]
        return np.asarray(there + grown * turn @ (point - here))

    @property
    def rms(self) -> float | None:
        """Root mean square of the residuals, world units of the target."""
        known = [value for value in self.residuals if value is not None]
        return float(np.sqrt(np.mean(np.square(known)))) if known else None
