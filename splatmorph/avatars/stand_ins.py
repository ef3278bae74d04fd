"""Stand-ins for the objects of chumpy and scipy that arrays were pickled in."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from splatmorph.avatars.opcodes import Made

LARGEST_SPARSE = 1 << 22
"""Entries of a sparse matrix made dense; FLAME's has 25 115."""


class StandIn(Made):
    """What an object of a library was pickled with; the library is not needed."""

    def __init__(self) -> None:
        self.state: dict[str, Any] = {}

    def build(self, state: object) -> None:
        """Take the object's fields."""
        self.state = dict(state) if isinstance(state, dict) else {}

    def array(self) -> NDArray[Any]:
        """What it stands for, as an array; see :func:`as_array` for what it raises."""
        raise ValueError("it is no array")


class Chumpy(StandIn):
    """An array of chumpy: its values in ``x``, or ``a`` picked by ``idxs`` (chumpy's Select)."""

    def array(self) -> NDArray[Any]:
        """The values, as chumpy's ``.r`` gives them."""
        if "x" in self.state:
            return as_array(self.state["x"])
        picked = as_array(self.state["a"]).ravel()[as_array(self.state["idxs"])]
        shape = self.state.get("preferred_shape")
        return picked if shape is None else picked.reshape(as_array(shape))


class Sparse(StandIn):
    """A matrix of scipy.sparse; which layout shows in the arrays that it has."""

    by_columns = False

    def array(self) -> NDArray[Any]:
        """The matrix, dense."""
        data = as_array(self.state["data"])
        rows, columns = shape_of(self.state.get("_shape") or self.state["shape"])
        if rows * columns > LARGEST_SPARSE:
            raise ValueError(f"a sparse matrix of {rows} by {columns}")
        if "indptr" not in self.state:
            where = self.state.get("coords") or (self.state["row"], self.state["col"])
            return _scatter(data, as_array(where[0]), as_array(where[1]), (rows, columns))
        minor = as_array(self.state["indices"])
        counts = np.diff(as_array(self.state["indptr"]))
        if counts.min(initial=0) < 0 or counts.sum() != len(data):
            raise ValueError("rows that overlap")
        major = np.repeat(np.arange(len(counts)), counts)
        if self.by_columns:
            return _scatter(data, minor, major, (rows, columns))
        return _scatter(data, major, minor, (rows, columns))


class SparseByColumns(Sparse):
    """csc."""

    by_columns = True


def as_array(value: Any) -> NDArray[Any]:
    """A value out of ``unpickle.load_pickle`` as a dense array.

    Raises:
        KeyError, ValueError, IndexError, TypeError: a stand-in that lacks what makes it an array.
    """
    return value.array() if isinstance(value, StandIn) else np.asarray(value)


def shape_of(stored: Any) -> tuple[int, ...]:
    """A shape as it is stored, no larger than a file could hold.

    Raises:
        ValueError, TypeError: it is none.
    """
    shape = tuple(stored)
    if len(shape) > 32 or not all(isinstance(n, int) and 0 <= n < 1 << 40 for n in shape):
        raise ValueError("a shape that is none")
    return shape


def _scatter(
    data: NDArray[Any], rows: NDArray[Any], columns: NDArray[Any], shape: tuple[int, ...]
) -> NDArray[Any]:
    dense = np.zeros(shape, data.dtype)
    np.add.at(dense, (rows, columns), data)
    return dense
