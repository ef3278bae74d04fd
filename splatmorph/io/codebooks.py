"""Numbers as indices into a few of them: the quantisation that SOG is made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEPS = 20
SAMPLE = 1 << 20
"""Numbers that a codebook is fitted to, at most."""
GROWTH = 1.5
"""How many times as many cells or groups there are after a pass of halving."""


def codebook(values: Array, size: int = 256) -> Array:
    """(size,) ascending numbers that stand for ``values`` (n,) with little squared error.

    Exact where ``values`` are no more than that. Else cells are halved at their mean, those with
    the largest squared error first, and then settle by Lloyd's iteration.
    """
    ordered = np.sort(values.ravel()[:: max(1, values.size // SAMPLE)])
    distinct = np.unique(ordered)
    if len(distinct) <= size and len(distinct) == len(np.unique(values)):
        return np.pad(distinct, (0, size - len(distinct)), mode="edge")
    sums, squares = (np.concatenate([[0.0], np.cumsum(ordered**power)]) for power in (1, 2))
    ends = np.array([0, len(ordered)])
    while len(ends) <= size:
        centers = np.diff(sums[ends]) / np.diff(ends)
        error = np.diff(squares[ends]) - np.diff(sums[ends]) * centers
        # In a cell of equal numbers there is nothing to halve.
        error[ordered[ends[:-1]] == ordered[ends[1:] - 1]] = 0
        count = min(size + 1 - len(ends), max(1, int(len(ends) * (GROWTH - 1))))
        worst = np.argsort(error)[-count:]
        worst = worst[error[worst] > 0]
        if not len(worst):
            break
        ends = np.union1d(ends, np.searchsorted(ordered, centers[worst], side="right"))
    for _ in range(STEPS):
        centers = np.diff(sums[ends]) / np.diff(ends)
        between = np.searchsorted(ordered, _middles(centers))
        ends = np.unique(np.concatenate([[0], between, [len(ordered)]]))
    return np.pad(centers, (0, size - len(centers)), mode="edge")


def nearest(values: Array, centers: Array) -> NDArray[np.uint8]:
    """The index of the nearest of ascending ``centers`` for each value, in their shape."""
    return np.searchsorted(_middles(centers), values).astype(np.uint8)


def grouped(rows: Array, most: int) -> tuple[Array, NDArray[np.int64]]:
    """Rows (n, d) as ``most`` of them at most: (k, d) means of groups, and the group of each (n,).

    A row is a group where there are no more. Else groups are halved at the median of the axis that
    they spread along most, those with the largest squared error first.
    """
    n = len(rows)
    if n <= most:
        return rows, np.arange(n)
    order, starts = np.arange(n), np.array([0])
    while len(starts) < most:
        ends = np.append(starts[1:], n)
        number = (ends - starts)[:, None]
        placed = rows[order]
        mean = np.add.reduceat(placed, starts) / number
        spread = np.add.reduceat(placed**2, starts) - number * mean**2
        error = np.where(number[:, 0] > 1, spread.sum(axis=1), -1.0)
        count = min(most - len(starts), max(1, int(len(starts) * (GROWTH - 1))))
        chosen = np.sort(np.argsort(error)[-count:])
        chosen = chosen[number[chosen, 0] > 1]
        # Rows keep their group; within those chosen they are sorted along its widest axis.
        group = np.repeat(np.arange(len(starts)), number[:, 0])
        key = np.zeros(n)
        split = np.isin(group, chosen)
        key[split] = placed[split, spread.argmax(axis=1)[group[split]]]
        order = order[np.lexsort((key, group))]
        starts = np.sort(np.concatenate([starts, starts[chosen] + number[chosen, 0] // 2]))
    labels = np.empty(n, np.int64)
    labels[order] = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, n)))
    means = np.add.reduceat(rows[order], starts) / np.diff(np.append(starts, n))[:, None]
    return means, labels


def _middles(centers: Array) -> Array:
    return (centers[1:] + centers[:-1]) / 2
