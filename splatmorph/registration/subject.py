"""A splat made ready to be registered: cleaned, at unit size, its surface sampled."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from splatmorph.gaussians import Gaussians
from splatmorph.geometry.similarity import Similarity
from splatmorph.geometry.spreading import farthest
from splatmorph.registration import descriptors
from splatmorph.registration.surfaces import Array, Surface, see_surface
from splatmorph.registration.views import MATCHED

SAMPLES = 2600
RING = (0.06, 0.3)
"""Radii between which a point is compared with its surroundings."""
REFERENCES = 1200
UNLIKE = 0.15
"""Quantile of the descriptor's distance to the surroundings that says how much detail is here."""
MOST_STRETCH = 3.0


@dataclass(frozen=True)
class Subject:
    """One side of a registration, in its own coordinates: center 0, root mean square radius 1."""

    gaussians: Gaussians
    dense: Surface
    """Some thousands of points."""
    samples: Surface
    """Those that are matched: more where there is more to see."""
    to_unit: Similarity
    """World → unit."""

    def posed(self, pose: Similarity) -> Subject:
        """The same moved by a similarity of unit coordinates."""
        return Subject(
            self.gaussians.moved(pose),
            turned(self.dense, pose),
            turned(self.samples, pose),
            pose @ self.to_unit,
        )

    def with_samples(self, count: int) -> Subject:
        """The same with the first samples only, which lie over all of the surface."""
        return replace(self, samples=self.samples.select(np.arange(min(count, len(self.samples)))))


def prepare(gaussians: Gaussians, *, samples: int = SAMPLES, seed: int = 0) -> Subject:
    """See the surface of a (cleaned) splat and choose the points that are matched.

    Raises:
        LandmarkError: next to no surface is to be seen.
    """
    dense, center, radius = see_surface(gaussians, MATCHED)
    middle = torch.from_numpy(center)
    to_unit = Similarity(torch.eye(3, dtype=torch.float64), 1 / radius, -middle / radius)
    gaussians, dense = gaussians.moved(to_unit), turned(dense, to_unit)
    stretch = np.sqrt(np.clip(_detail(gaussians, dense), 1 / MOST_STRETCH, MOST_STRETCH))
    first = int(np.random.default_rng(seed).integers(len(dense.points))) if seed else 0
    chosen = farthest(dense.points, samples, first=first, stretch=stretch)
    return Subject(gaussians, dense, dense.select(chosen), to_unit)


def _detail(gaussians: Gaussians, surface: Surface) -> Array:
    """(n,) how unlike its surroundings each point looks; 1 is the usual."""
    cameras = descriptors.cameras_of(np.zeros(3))
    seen = descriptors.describe(gaussians, surface.points, surface.normals, cameras)
    few = farthest(surface.points, REFERENCES, first=0)
    where = torch.full((len(surface),), -1)
    where[torch.from_numpy(few)] = torch.arange(len(few))
    references = []
    for one in seen:
        index = where[one.index]
        kept = index >= 0
        references.append(descriptors.Seen(index[kept], one.weights[kept], one.values[kept]))
    unlike, common = descriptors.distances(seen, references, (len(surface), len(few)))
    points = torch.from_numpy(surface.points).float()
    apart = torch.cdist(points, points[torch.from_numpy(few)])
    ring = (apart > RING[0]) & (apart < RING[1]) & (common > descriptors.COMMON)
    detail = _low_quantile(unlike.masked_fill_(~ring, torch.inf), ring.sum(1))
    known = detail.isfinite()
    detail = torch.where(known, detail, detail[known].median() if known.any() else 1.0)
    return np.asarray(detail / detail.median()).astype(np.float64)


def _low_quantile(values: Tensor, counts: Tensor) -> Tensor:
    """The quantile ``UNLIKE`` of the ``counts`` (n,) smallest of each row (n, m): (n,)."""
    rank = UNLIKE * (counts - 1).clamp_min(0)
    low = rank.floor().long()
    lowest = values.topk(min(int(low.max()) + 2, values.shape[1]), largest=False).values
    below, above = (lowest.gather(1, i[:, None])[:, 0] for i in (low, low + (rank > low)))
    return torch.where(counts > 0, below + (rank - low) * (above - below), torch.inf)


def turned(surface: Surface, similarity: Similarity) -> Surface:
    """The surface moved by a similarity; what its features say stays true."""
    return Surface(
        similarity(torch.from_numpy(surface.points)).numpy(),
        surface.normals @ similarity.rotation.numpy().T,
        surface.features,
    )
