"""PLY files as columns, for tests that change them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyElement


def stored_columns(path: Path) -> dict[str, np.ndarray]:
    """The properties of a PLY file's vertices, as stored."""
    data = PlyData.read(path)["vertex"].data
    return {name: np.array(data[name]) for name in data.dtype.names}


def write_columns(
    path: Path, columns: dict[str, np.ndarray], *, text: bool = False, byte_order: str = "<"
) -> None:
    """A PLY file of one element, its properties in the order of ``columns``."""
    n = len(next(iter(columns.values())))
    table = np.empty(n, [(name, value.dtype) for name, value in columns.items()])
    for name, value in columns.items():
        table[name] = value
    element = PlyElement.describe(table, "vertex")
    PlyData([element], text=text, byte_order=byte_order).write(path)
