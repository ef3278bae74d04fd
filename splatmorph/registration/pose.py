"""How the source must be turned, scaled and moved to lie on the target.

Geometry proposes and appearance decides: an annealed soft assignment of surface points finds the
basins from rotations all over SO(3), and one look at both splats from common cameras says which
is right. No more time is spent on the pose: the flow that follows forgets where it started.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from splatmorph.geometry.quaternions import to_matrices
from splatmorph.geometry.similarity import Similarity
from splatmorph.geometry.spreading import farthest
from splatmorph.registration import descriptors
from splatmorph.registration.assignment import soft
from splatmorph.registration.matches import FACINGS, LOOKS, SHAPES
from splatmorph.registration.subject import Subject, turned
from splatmorph.registration.surfaces import Surface

STARTS, BATCH = 96, 16
COARSE, FINE, JUDGED = 300, 900, 1000
"""Points to search with, to refine with, to judge with."""
COARSE_SIGMAS = (0.6, 0.5, 0.4, 0.35, 0.3, 0.27, 0.24, 0.21, 0.18, 0.15)
FINE_SIGMAS = (0.25, 0.2, 0.17, 0.14, 0.12, 0.1)
FEATURES, NORMALS, OUTLIER = 0.1, 0.6, 0.3
"""What unlike features and normals cost, and a point's having no partner."""
SCALES = (0.4, 2.5)
"""Between two objects of unit size; cropped or bearded ones differ by some tenths."""
KEPT = 6
SAME_BASIN, OTHER_BASIN, NEARBY = 20.0, 30.0, 20.0
"""Degrees."""
REACH = 0.15
"""Radii at which, when poses are judged, distance costs one half."""
MOST_COST = (6.0, 14.0)
"""A point's cost is cut off there: by geometry, by appearance."""
MARGIN = 0.03
"""The pose as it lies stays unless another is better by this share; three times that where the
other is less than NEARBY away, since the score doesn't see 10 mm on a head."""


@dataclass(frozen=True)
class Pose:
    """A candidate, in unit coordinates of both sides."""

    similarity: Similarity
    """Source → target."""
    score: float
    """Lower is better."""


def find_poses(source: Subject, target: Subject, as_is: Similarity) -> list[Pose]:
    """The poses that may be right, best first, one for each basin.

    ``as_is`` is the pose that leaves the source where it lies.
    """
    judge = _Judge(source, target)
    found = sorted((judge.pose(one) for one in _propose(source, target)), key=_score)
    basins: list[Pose] = []
    for pose in found:
        if all(angle(pose.similarity, other.similarity) > SAME_BASIN for other in basins):
            basins.append(pose)
    lying = judge.pose(as_is)
    best = basins[0]
    near = angle(best.similarity, as_is) < NEARBY
    if lying.score < best.score * (1 + (3 * MARGIN if near else MARGIN)):
        others = [pose for pose in basins if angle(pose.similarity, as_is) > SAME_BASIN]
        return [lying, *others]
    return basins


def rival(poses: list[Pose]) -> tuple[Pose, float] | None:
    """The best pose that is turned far from the first, and how much worse it is, as a share."""
    best = poses[0]
    others = [p for p in poses[1:] if angle(p.similarity, best.similarity) > OTHER_BASIN]
    if not others:
        return None
    other = min(others, key=_score)
    return other, other.score / best.score - 1


def angle(a: Similarity, b: Similarity) -> float:
    """Degrees between the rotations of two similarities."""
    cosine = (float((a.rotation.T @ b.rotation).trace()) - 1) / 2
    return math.degrees(math.acos(max(-1.0, min(1.0, cosine))))


def rotations(count: int, seed: int = 0) -> Tensor:
    """``count`` rotations (count, 3, 3) that fill SO(3) evenly, the identity first."""
    quats = np.random.default_rng(seed).normal(size=(20 * count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    quats[0] = 1, 0, 0, 0
    picked, gap = [0], np.full(len(quats), 2.0)
    for _ in range(count - 1):
        gap = np.minimum(gap, 1 - np.abs(quats @ quats[picked[-1]]))
        picked.append(int(gap.argmax()))
    return to_matrices(torch.from_numpy(quats[picked])).float()


def _score(pose: Pose) -> float:
    return pose.score


class _Judge:
    """Scores poses by what both sides look like from the same cameras."""

    def __init__(self, source: Subject, target: Subject) -> None:
        self.gaussians = source.gaussians
        self.a, self.b = (_few(side.samples, JUDGED) for side in (source, target))
        self.cameras = descriptors.cameras_of(np.zeros(3))
        self.seen = descriptors.describe(
            target.gaussians, self.b.points, self.b.normals, self.cameras
        )
        features = torch.cdist(torch.from_numpy(self.a.features), torch.from_numpy(self.b.features))
        self.shapes = SHAPES * features.square()

    def pose(self, similarity: Similarity) -> Pose:
        """The candidate with its score."""
        a, b = turned(self.a, similarity), self.b
        seen = descriptors.describe(
            self.gaussians.moved(similarity), a.points, a.normals, self.cameras
        )
        looks, _ = descriptors.distances(seen, self.seen, (len(a), len(b)))
        points, there, normals, facing = (
            torch.from_numpy(value).float() for value in (a.points, b.points, a.normals, b.normals)
        )
        costs = torch.cdist(points, there).square() / (2 * REACH**2) + LOOKS * looks + self.shapes
        costs += FACINGS * (1 - normals @ facing.T)
        return Pose(similarity, _mean_best(costs, MOST_COST[1]))


def _mean_best(costs: Tensor, most: float) -> float:
    return float(costs.amin(1).clamp_max(most).mean() + costs.amin(0).clamp_max(most).mean())


def _few(surface: Surface, count: int) -> Surface:
    return surface.select(farthest(surface.points, count, first=0))


def _propose(source: Subject, target: Subject) -> list[Similarity]:
    """Distinct similarities that lay one surface on the other by shape alone, best first."""
    coarse = _Alignment(_few(source.samples, COARSE), _few(target.samples, COARSE))
    turns = rotations(STARTS)
    parts = [coarse.anneal(_Batch.of(part), COARSE_SIGMAS) for part in turns.split(BATCH)]
    found = _Batch(*(torch.cat(column) for column in zip(*parts, strict=True)))
    distinct: list[int] = []
    for i in coarse.scores(found).argsort().tolist():
        traces = [float((found.R[i].T @ found.R[j]).trace()) for j in distinct]
        if all(trace < 2.8 for trace in traces):
            distinct.append(i)
        if len(distinct) == KEPT:
            break
    fine = _Alignment(_few(source.samples, FINE), _few(target.samples, FINE))
    best = fine.anneal(_Batch(*(column[distinct] for column in found)), FINE_SIGMAS)
    return [best.similarity(i) for i in fine.scores(best).argsort().tolist()]


class _Batch(NamedTuple):
    """k similarities y = s R x + t."""

    R: Tensor
    """(k, 3, 3)"""
    s: Tensor
    """(k,)"""
    t: Tensor
    """(k, 3)"""

    @staticmethod
    def of(rotations: Tensor) -> _Batch:
        return _Batch(rotations, torch.ones(len(rotations)), torch.zeros(len(rotations), 3))

    def __call__(self, x: Tensor) -> Tensor:
        """(m, 3) -> (k, m, 3)"""
        return self.s[:, None, None] * (x @ self.R.mT) + self.t[:, None]

    def similarity(self, i: int) -> Similarity:
        # In single precision a rotation is one to 1e-6 at best.
        U, _, Vt = torch.linalg.svd(self.R[i].double())
        return Similarity(U @ Vt, float(self.s[i]), self.t[i].double())


class _Alignment:
    """Annealed soft assignment of two point sets under similarities (Gold et al. 1998)."""

    def __init__(self, a: Surface, b: Surface) -> None:
        self.a, self.b, self.a_normals, self.b_normals = (
            torch.from_numpy(value).float() for value in (a.points, b.points, a.normals, b.normals)
        )
        features = torch.cdist(torch.from_numpy(a.features), torch.from_numpy(b.features))
        self.features = FEATURES * features.square()

    def costs(self, batch: _Batch, sigma: float) -> Tensor:
        """(k, n, m)"""
        apart = torch.cdist(batch(self.a), self.b.expand(len(batch.s), -1, -1)).square()
        facing = (self.a_normals @ batch.R.mT) @ self.b_normals.T
        return apart / (2 * sigma**2) + self.features + NORMALS * (1 - facing)

    def anneal(self, batch: _Batch, sigmas: Sequence[float]) -> _Batch:
        """Assign and align, in ever narrower windows."""
        for sigma in sigmas:
            batch = self._align(soft(self.costs(batch, sigma), OUTLIER))
        return batch

    def scores(self, batch: _Batch) -> Tensor:
        """(k,) mean cost of the best partner, both ways: lower is better."""
        costs, most = self.costs(batch, REACH), MOST_COST[0]
        return costs.amin(2).clamp_max(most).mean(1) + costs.amin(1).clamp_max(most).mean(1)

    def _align(self, plan: Tensor) -> _Batch:
        """The similarities of soft matches (k, n, m), their scale the same both ways (Horn)."""
        total = plan.sum((1, 2))[:, None]
        mass_a, mass_b = plan.sum(2), plan.sum(1)
        center_a, center_b = mass_a @ self.a / total, mass_b @ self.b / total
        a, b = self.a - center_a[:, None], self.b - center_b[:, None]
        spread_a, spread_b = (
            (mass * x.square().sum(2)).sum(1) for mass, x in ((mass_a, a), (mass_b, b))
        )
        U, _, Vt = torch.linalg.svd((plan @ b).mT @ a)
        sign = torch.ones_like(total).expand(-1, 3).clone()
        sign[:, 2] = torch.sign(torch.det(U @ Vt))
        R = (U * sign[:, None]) @ Vt
        s = (spread_b / spread_a).sqrt().clamp(*SCALES)
        return _Batch(R, s, center_b - s[:, None] * (R @ center_a[..., None])[..., 0])
