"""Points spread evenly over an implicit surface, as dense as a spacing function asks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from splatmorph.samples.implicit import Array, Field, column, project

HEXAGON = 0.866
"""Area of a point's cell over its squared spacing, in a hexagonal packing."""


@dataclass(frozen=True)
class Grid:
    """A field sampled on a regular lattice, for the many cheap looks that shading takes."""

    values: Array
    """(a, b, c) signed distances, mm."""
    origin: Array
    """(3, 1) position of the first sample, mm."""
    cell: float
    """Edge of a cell, mm."""

    @staticmethod
    def of(field: Field, low: tuple[float, ...], high: tuple[float, ...], cell: float) -> Grid:
        axes = [
            np.arange(a, b + cell, cell, dtype=np.float32) for a, b in zip(low, high, strict=True)
        ]
        points = np.stack(np.meshgrid(*axes, indexing="ij")).astype(np.float32)
        values = field(points.reshape(3, -1)).reshape(points.shape[1:])
        return Grid(values, column(low), cell)

    def __call__(self, p: Array) -> Array:
        """Trilinear interpolation; beyond the lattice its border holds."""
        return map_coordinates(self.values, (p - self.origin) / self.cell, order=1, mode="nearest")

    def cells_near_zero(self) -> Array:
        """(3, m) lattice points whose cell the surface may cross."""
        index = np.stack(np.nonzero(np.abs(self.values) < self.cell * 0.9))
        return self.origin + self.cell * index.astype(np.float32)


def scatter(
    field: Field, grid: Grid, spacing: Field, rng: np.random.Generator, *, relaxations: int = 8
) -> Array:
    """(3, n) points on the zero set of ``field``, about ``spacing(p)`` mm from their neighbours."""
    cells = grid.cells_near_zero()
    wanted = grid.cell**2 / (HEXAGON * spacing(cells) ** 2)
    cells = np.repeat(cells, rng.poisson(np.minimum(wanted, 400)), axis=1)
    p = cells + rng.uniform(-0.5, 0.5, cells.shape).astype(np.float32) * grid.cell
    p = p[:, np.abs(field(p)) < grid.cell / 2]
    p = project(field, p)
    p = p[:, np.abs(field(p)) < 0.2]
    for _ in range(relaxations):
        p = project(field, repel(p, spacing(p)), steps=1)
    return p[:, np.abs(field(p)) < 0.2]


def repel(p: Array, spacing: Array, neighbours: int = 7) -> Array:
    """The points pushed apart where they stand closer than their spacing."""
    gap, index = cKDTree(p.T).query(p.T, k=neighbours, workers=-1)
    away = (p[:, :, None] - p[:, index[:, 1:]]) / np.maximum(gap[:, 1:], 1e-3)
    push = np.maximum(1.25 * spacing[:, None] - gap[:, 1:], 0)
    return p + (0.22 * (away * push).sum(2)).astype(np.float32)


def local_spacing(p: Array, neighbours: int = 6) -> Array:
    """(n,) distance to the farthest of the nearest neighbours, mm: larger beside a gap."""
    gap, _ = cKDTree(p.T).query(p.T, k=neighbours + 1, workers=-1)
    return gap[:, -1].astype(np.float32)
