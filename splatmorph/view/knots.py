"""Knots: a path in time kept as the polynomial through a few of its points.

The paths of a flow are smooth in t, so the polynomial through Chebyshev points meets them to
within 2⁻ᵏ and better (Trefethen, Approximation Theory and Practice, ch. 8), and its weights at
a time t are the same for all paths.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COUNTS = (2, 3, 5, 9)
"""Each set of knots holds the one before: halving the angles of Chebyshev points adds points."""
FINEST = 17


def knot_times(count: int) -> Array:
    """The (count,) Chebyshev points of the second kind on [0, 1], both ends among them."""
    return (1 - np.cos(np.pi * np.arange(count) / (count - 1))) / 2


def knot_weights(times: Array, t: float) -> Array:
    """(k,) weights of the values at ``times`` (k,) in the polynomial's value at t (Lagrange)."""
    gaps = times[:, None] - times[None, :] + np.eye(len(times))
    ratios = (t - times[None, :]) / gaps
    np.fill_diagonal(ratios, 1)
    return np.asarray(ratios.prod(axis=1))


def fewest_knots(paths: Array, tolerance: float) -> int:
    """The smallest of ``COUNTS`` whose polynomial leaves no path by more than ``tolerance``.

    paths: (FINEST, m, 3) points of m paths at ``knot_times(FINEST)``. The largest count where
    none is good enough.
    """
    finest = knot_times(FINEST)
    for count in COUNTS:
        step = (FINEST - 1) // (count - 1)
        times, values = knot_times(count), paths[::step]
        misses = [
            np.linalg.norm(np.tensordot(knot_weights(times, t), values, 1) - truth, axis=1).max()
            for t, truth in zip(finest, paths, strict=True)
        ]
        if max(misses) <= tolerance:
            return count
    return COUNTS[-1]
