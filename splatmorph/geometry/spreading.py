"""Some of many points, spread out over all."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def farthest(
    points: NDArray[Any],
    count: int,
    *,
    first: int | None = None,
    stretch: NDArray[Any] | None = None,
) -> NDArray[np.intp]:
    """Indices of up to ``count`` of the (n, d) points, each next one farthest from all before.

    Arguments:
        first: where to begin; None: at the point that is farthest from the mean.
        stretch: (n,), multiplies a point's distance to the others: more of them where it is
            large.
    """
    if len(points) <= count:
        return np.arange(len(points))
    if first is None:
        first = int(((points - points.mean(0)) ** 2).sum(1).argmax())
    squares = None if stretch is None else stretch**2
    axes = np.ascontiguousarray(points.T)
    picked, gap = [first], np.full(len(points), np.inf)
    square, offset = np.empty_like(gap), np.empty_like(gap)
    for _ in range(count - 1):
        square.fill(0)
        for axis in axes:
            np.subtract(axis, axis[picked[-1]], out=offset)
            square += np.multiply(offset, offset, out=offset)
        np.minimum(gap, square, out=gap)
        spread = gap if squares is None else np.multiply(gap, squares, out=offset)
        picked.append(int(spread.argmax()))
    return np.array(picked[:count], dtype=np.intp)
