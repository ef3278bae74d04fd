"""Implicit solids: signed distances of simple bodies and smooth ways to join them.

Points are (3, n) float32 arrays in millimetres; a field maps them to (n,) signed distances,
negative inside. The ellipsoid and the smooth minimum are the well-known approximations of
Quilez, "Distance functions", iquilezles.org.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Field = Callable[[Array], Array]
Point = Sequence[float]


def column(point: Point) -> Array:
    """One point as a (3, 1) column, to be broadcast against points."""
    return np.asarray(point, np.float32)[:, None]


def length(p: Array) -> Array:
    """(n,) Euclidean lengths of (3, n) vectors."""
    return np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])


def ellipsoid(p: Array, center: Point, radii: Point) -> Array:
    """An axis-aligned ellipsoid; the distance is exact to first order at the surface."""
    radii_column = column(radii)
    q = (p - column(center)) / radii_column
    k0 = length(q)
    k1 = length(q / radii_column)
    return k0 * (k0 - 1) / np.maximum(k1, 1e-6)


def capsule(p: Array, a: Point, b: Point, radius_a: float, radius_b: float) -> Array:
    """A rod from ``a`` to ``b`` whose radius runs linearly between its ends."""
    start, axis = column(a), column(b) - column(a)
    q = p - start
    h = np.clip((q * axis).sum(0) / float((axis * axis).sum()), 0, 1)
    return length(q - axis * h) - (radius_a + (radius_b - radius_a) * h)


def tube(p: Array, points: Sequence[Point], radii: Sequence[float]) -> Array:
    """A chain of rods through ``points``."""
    distance = capsule(p, points[0], points[1], radii[0], radii[1])
    for i in range(1, len(points) - 1):
        rod = capsule(p, points[i], points[i + 1], radii[i], radii[i + 1])
        distance = np.minimum(distance, rod)
    return distance


def join(a: Array, b: Array, width: float) -> Array:
    """Union with a fillet of ``width``."""
    h = np.maximum(width - np.abs(a - b), 0) / width
    return np.minimum(a, b) - h * h * (width / 4)


def carve(a: Array, b: Array, width: float) -> Array:
    """``a`` without ``b``, the edge rounded over ``width``."""
    return -join(-a, b, width)


def meet(a: Array, b: Array, width: float) -> Array:
    """Intersection, the edge rounded over ``width``."""
    return -join(-a, -b, width)


def mirrored(p: Array, blend: float = 1.5) -> Array:
    """The points folded to x > 0, smoothly over ``blend`` so that no crease shows in the middle."""
    return np.stack([np.sqrt(p[0] * p[0] + blend * blend), p[1], p[2]])


def near(p: Array, center: Point, reach: float, body: Field) -> Array:
    """``body`` evaluated only within ``reach`` of ``center``; elsewhere a safe lower bound of it.

    ``body`` must lie well inside that ball: details are small, and most points are far away.
    """
    away = length(p - column(center))
    distance = away - reach * 0.6
    inside = np.flatnonzero(away < reach)
    distance[inside] = body(p[:, inside])
    return distance


def gradient(field: Field, p: Array, step: float = 0.15) -> Array:
    """(3, n) gradient by the four differences of a tetrahedron."""
    total = np.zeros_like(p)
    for corner in ((1, -1, -1), (-1, -1, 1), (-1, 1, -1), (1, 1, 1)):
        offset = column(corner)
        total += offset * field(p + step * offset)
    return total / (4 * step)


def project(field: Field, p: Array, steps: int = 3, level: float | Array = 0.0) -> Array:
    """The points moved along the gradient to where the field equals ``level``."""
    for _ in range(steps):
        slope = gradient(field, p)
        squared = np.maximum((slope * slope).sum(0), 0.1)
        p = p - slope * np.clip((field(p) - level) / squared, -8, 8)
    return p


def normals(field: Field, p: Array) -> Array:
    """(3, n) unit outward normals."""
    slope = gradient(field, p)
    return slope / np.maximum(length(slope), 1e-6)


def trace(field: Field, start: Array, direction: Array, steps: int = 96) -> Array:
    """The first points at which rays from outside meet the solid; (3, n) unit directions."""
    p = start.copy()
    for _ in range(steps):
        p += direction * (field(p) * 0.7)
    return p


def smoothstep(low: float, high: float, x: Array) -> Array:
    """0 below ``low``, 1 above ``high`` (or the other way round), with soft ends."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
