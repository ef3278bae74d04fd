"""Knots: a path in time kept as the polynomial through a few of its points.

The paths of a flow are smooth in t, so the polynomial through Chebyshev points meets them to
within 2⁻ᵏ and better (Trefethen, Approximation Theory and Practice, ch. 8), and its weights at
a time t are the same for all paths.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST = 9
"""The most knots a path is given."""
FINEST = 17
"""Points of a path that stand for the true one while its knots are chosen."""


def knot_times(count: int) -> Array:
    """The (count,) Chebyshev points of the second kind on [0, 1], both ends among them."""
    return (1 - np.cos(np.pi * np.arange(count) / (count - 1))) / 2


def knot_weights(times: Array, t: float) -> Array:
    """(k,) weights of the values at ``times`` (k,) in the polynomial's value at t (Lagrange)."""
    gaps = times[:, None] - times[None, :] + np.eye(len(times))
    ratios = (t - times[None, :]) / gaps
    np.fill_diagonal(ratios, 1)
    return np.asarray(ratios.prod(axis=1))


def knot_matrix(times: Array, wanted: Array) -> Array:
    """(w, k): ``knot_weights`` for each of the (w,) wanted times."""
    return np.array([knot_weights(times, t) for t in wanted])


def fewest_knots(paths: Array, tolerance: float) -> int:
    """The fewest knots, 2 to ``MOST``, whose polynomial leaves no path by more than ``tolerance``.

    paths: (FINEST, m, 3) points of m paths at ``knot_times(FINEST)``. ``MOST`` where no fewer
    are enough.
    """
    finest = knot_times(FINEST)
    for count in range(2, MOST):
        times = knot_times(count)
        there_and_back = knot_matrix(times, finest) @ knot_matrix(finest, times)
        missed = np.tensordot(there_and_back - np.eye(FINEST), paths, 1)
        if np.linalg.norm(missed, axis=2).max() <= tolerance:
            return count
    return MOST
