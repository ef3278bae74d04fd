"""Neighbours: means and slopes over the splats around a point."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import embedding_bag

from splatmorph.gaussians import Gaussians

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

COUNT = 24
"""Neighbours of a splat, itself among them."""

Points = NDArray[np.float64]
Index = NDArray[np.int64]

FAINT = 0.05
"""What a neighbour weighs beyond its opacity."""


def tree_of(points: Points) -> cKDTree:
    """What knows the nearest of points (n, 3); loaded when it is needed, since it takes long."""
    from scipy.spatial import cKDTree

    return cKDTree(points)


def nearest(tree: cKDTree, points: Points, count: int) -> tuple[Points, Index]:
    """Distances and indices (n, count) of what is nearest in ``tree`` to points (n, 3)."""
    # Asked one beside the other, what a point visits is in the cache for the next.
    order = tree_of(points).indices
    distance, index = np.empty((len(points), count)), np.empty((len(points), count), np.int64)
    found = tree.query(points[order], list(range(1, count + 1)), workers=-1)
    distance[order], index[order] = found
    return distance, index


class Neighbours:
    """The splats nearest to each of some points, and how much each of them counts.

    Arguments:
        gaussians: whose neighbours.
        points: (n, 3) around where; around every splat itself if not given.
    """

    def __init__(self, gaussians: Gaussians, points: Tensor | None = None) -> None:
        means = gaussians.means.double().numpy(force=True)
        at = means if points is None else points.double().numpy(force=True)
        distance, index = nearest(tree_of(means), at, min(COUNT, len(means)))
        self.index = torch.from_numpy(index)
        near = distance / (distance[:, -1:] / 1.5 + 1e-12)
        weights = torch.from_numpy(np.exp(-0.5 * near**2)).float()
        self.weights = weights * (FAINT + gaussians.opacities.float()[self.index])

    def sums(self, values: Tensor) -> Tensor:
        """Weighted sums (n, c) of the splats' values (m, c)."""
        values = values.contiguous()
        summed: Tensor = embedding_bag(
            self.index, values, mode="sum", per_sample_weights=self.weights.to(values)
        )
        return summed

    def means(self, values: Tensor, certainty: Tensor | None = None) -> Tensor:
        """Weighted means (n, c) of values (m, c), each as certain as (m,) says."""
        if certainty is None:
            return self.sums(values) / self.weights.sum(1, keepdim=True)
        both = self.sums(torch.cat([values * certainty[:, None], certainty[:, None]], 1))
        return both[:, :-1] / both[:, -1:].clamp_min(1e-6)

    def slopes(self, points: Tensor, values: Tensor) -> Tensor:
        """∂values/∂points (n, c, 3) of values (n, c) at points (n, 3), by least squares."""
        apart = points[self.index] - points[:, None]
        rise = values[self.index] - values[:, None]
        moments = torch.einsum("nk,nki,nkj->nij", self.weights, apart, apart)
        mixed = torch.einsum("nk,nkc,nkj->ncj", self.weights, rise, apart)
        # On a sheet nothing tells the slope across: there it is small.
        ridge = 0.1 * torch.einsum("nii->n", moments) + 1e-30
        moments = moments + ridge[:, None, None] * torch.eye(3, dtype=moments.dtype)
        solved: Tensor = torch.linalg.solve(moments, mixed.mT)
        return solved.mT
