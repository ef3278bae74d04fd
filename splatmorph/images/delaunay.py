"""Delaunay: the classical piecewise-affine warp, for comparison."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import torch
from PIL import Image, ImageDraw
from scipy.spatial import Delaunay, QhullError
from torch import Tensor

from splatmorph.errors import LandmarkError
from splatmorph.geometry.similarity import Similarity
from splatmorph.images.canvas import Canvas
from splatmorph.images.warp import PixelMap
from splatmorph.landmarks import Landmarks


@dataclass(frozen=True)
class DenseMap:
    """A map known at every pixel."""

    values: Tensor
    """(height, width, 2) float32 world positions."""

    def band(self, first: int, last: int) -> Tensor:
        """As ``PixelMap.band``."""
        return self.values[first:last]


@dataclass(frozen=True)
class DelaunayWarp:
    """Triangles between the landmarks, each moved by its own affine map.

    As morphing with OpenCV is usually shown: landmarks move on straight lines, one Delaunay
    triangulation of their middle positions serves all times, and the border of the picture is
    pinned. Triangles may turn over; then the warp folds. With a frame S, in which the target
    stands, the lines lead from p to S⁻¹q, and S(t) is played.

    Raises:
        LandmarkError: the landmarks don't match, or all lie on one line.
    """

    source: Landmarks
    target: Landmarks
    border: Canvas
    """The picture whose border is pinned, at the corners and the middles of the sides."""
    frame: Similarity = field(default_factory=lambda: Similarity.identity(2))
    """S: where the target stands, seen from the source."""

    @cached_property
    def _sides(self) -> tuple[Tensor, Tensor]:
        p, q, _ = self.source.match(self.target)
        pinned = self.border.border(2)
        return torch.cat([p, pinned]), torch.cat([q, pinned])

    def _between(self, t: float) -> Tensor:
        p, q = self._sides
        return self.frame.power(t)((1 - t) * p + t * self.frame.inverse()(q))

    @cached_property
    def triangles(self) -> Tensor:
        """(triangles, 3) indices into the landmarks, then the pinned points."""
        p, q = self._sides
        middle = (p + self.frame.inverse()(q)) / 2
        try:
            return torch.from_numpy(Delaunay(middle.numpy()).simplices).long()
        except QhullError as error:
            raise LandmarkError(
                "the landmarks can't be triangulated: too few, or in line"
            ) from error

    def maps(self, canvas: Canvas, times: Sequence[float]) -> Iterator[tuple[PixelMap, PixelMap]]:
        """As ``Warp.maps``."""
        centers = canvas.centers()
        p, q = self._sides
        for t in times:
            middle = self._between(t)
            inside = self._labels(canvas, middle)
            yield (
                self._map(centers, inside, self._affine(middle, p)),
                self._map(centers, inside, self._affine(middle, q)),
            )

    def carry(self, points: Tensor, t: float) -> Tensor:
        """As ``Warp.carry``."""
        p, _ = self._sides
        corners = p[self.triangles]
        edges = (corners[:, 1:] - corners[:, :1]).mT
        local = torch.linalg.solve(edges, (points.to(p)[:, None] - corners[:, 0])[..., None])[
            ..., 0
        ]
        weights = torch.cat([1 - local.sum(-1, keepdim=True), local], dim=-1)
        # The triangle that holds the point, or the one that it is least outside of.
        best = weights.amin(-1).argmax(1)
        moved = self._between(t)[self.triangles[best]]
        chosen = weights[torch.arange(len(points)), best]
        return torch.einsum("mk,mkc->mc", chosen, moved).to(points)

    def _affine(self, start: Tensor, end: Tensor) -> Tensor:
        """(triangles + 1, 2, 3) maps of the triangles from ``start`` to ``end``; the last: none."""
        a, b = start[self.triangles], end[self.triangles]
        flat = torch.cat([a, torch.ones_like(a[..., :1])], dim=-1)
        maps = (torch.linalg.pinv(flat) @ b).mT
        return torch.cat([maps, torch.eye(2, 3).to(maps)[None]]).to(torch.float32)

    def _labels(self, canvas: Canvas, points: Tensor) -> Tensor:
        """(height, width) which triangle a pixel is in; beyond all, the number of triangles."""
        label = Image.new("I", (canvas.width, canvas.height), len(self.triangles))
        draw = ImageDraw.Draw(label)
        # Pillow's pixel centers are whole numbers.
        corners = (canvas.to_pixels(points) - 0.5)[self.triangles]
        for i, triangle in enumerate(corners.flatten(1).tolist()):
            draw.polygon(triangle, fill=i)
        return torch.from_numpy(np.array(label)).long()

    def _map(self, centers: Tensor, inside: Tensor, affine: Tensor) -> DenseMap:
        chosen = affine[inside]
        values = chosen[..., 2].clone()
        values += chosen[..., 0] * centers[..., :1]
        values += chosen[..., 1] * centers[..., 1:]
        return DenseMap(values)
