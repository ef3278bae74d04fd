"""Compressed PLY, as PlayCanvas and SuperSplat read it: words of 32 bits in chunks of 256 splats.

A chunk holds the bounds of its positions, log scales and colours, and its splats lie between them:
positions and scales in 11, 10 and 11 bits, colours in 8 each. Quaternions lack their largest
component and keep 10 bits of the others; harmonics above degree 0 are bytes over ±4.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splatmorph.errors import ReadError
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import SH0
from splatmorph.io.axes import vertical_comments
from splatmorph.io.elements import Columns, Rows, write_elements
from splatmorph.io.packed import (
    Array,
    drop_largest,
    opacity_bytes,
    restore_largest,
    stored_arrays,
    unpacked,
)

CHUNK = 256
WORDS = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
BOUNDS = {
    "packed_position": ("min_x", "min_y", "min_z", "max_x", "max_y", "max_z"),
    "packed_scale": tuple(f"{end}_scale_{axis}" for end in ("min", "max") for axis in "xyz"),
    "packed_color": ("min_r", "min_g", "min_b", "max_r", "max_g", "max_b"),
}
XYZ_BITS, RGBA_BITS, QUAT_BITS = (11, 10, 11), (8, 8, 8, 8), (10, 10, 10)
# A splat as thin as nothing must not cost the others of its chunk their precision.
LARGEST_LOG_SCALE = 20.0
SH_RANGE = 4.0
HIGHEST_DEGREE = 3


def is_compressed(elements: Mapping[str, Collection[str]]) -> bool:
    """Whether a PLY file with these elements is a compressed splat."""
    return "packed_position" in elements.get("vertex", {})


def unpack(elements: Mapping[str, Columns], path: str | Path) -> Gaussians:
    """The splat of a compressed PLY's elements; ``path`` is for the messages.

    Raises:
        ReadError: elements or properties are missing or don't fit each other, or values that no
            renderer can show.
    """
    vertex, chunk = elements["vertex"], elements.get("chunk", {})
    bounds = {**BOUNDS}
    if "min_r" not in chunk:
        # Older files spread colours over 0 to 1.
        del bounds["packed_color"]
    missing = [name for name in WORDS if vertex.get(name, np.empty(0)).dtype != np.uint32]
    missing += [name for names in bounds.values() for name in names if name not in chunk]
    if missing:
        raise ReadError(
            f"{path} is a compressed splat PLY without {', '.join(missing)}: export it again"
        )
    n = len(vertex["packed_position"])
    if len(chunk["min_x"]) * CHUNK < n:
        raise ReadError(
            f"{path} has {len(chunk['min_x'])} chunks for {n} splats, expected one for each "
            f"{CHUNK}: export it again"
        )

    def between(word: str, fractions: Array) -> Array:
        if word not in bounds:
            return fractions
        used = [chunk[name][: -(-n // CHUNK)] for name in bounds[word]]
        ends = np.stack(used, axis=1).astype(np.float64)
        low, high = np.repeat(ends, CHUNK, axis=0)[:n].reshape(n, 2, 3).transpose(1, 0, 2)
        return low + (high - low) * fractions

    colour = _split(vertex["packed_color"], RGBA_BITS)
    rotation = vertex["packed_rotation"].astype(np.int64)
    rest = (_split(rotation, QUAT_BITS) - 0.5) * np.sqrt(2)
    dc = (between("packed_color", colour[:, :3]) - 0.5) / SH0
    return unpacked(
        path,
        means=between("packed_position", _split(vertex["packed_position"], XYZ_BITS)),
        quats=restore_largest(rotation >> 30, rest),
        log_scales=between("packed_scale", _split(vertex["packed_scale"], XYZ_BITS)),
        opacities=colour[:, 3],
        sh=np.concatenate([dc[:, None], _harmonics(elements.get("sh", {}), n, path)], axis=1),
    )


def write_compressed_ply(
    path: str | Path, gaussians: Gaussians, comments: Sequence[str] = ()
) -> None:
    """Write a compressed PLY, in the order of ``gaussians``; harmonics to degree 3 at most.

    Raises:
        WriteError: see :func:`splatmorph.io.write`.
    """
    gaussians = gaussians.with_sh_degree(min(gaussians.sh_degree, HIGHEST_DEGREE))
    means, quats, log_scales, sh = stored_arrays(gaussians, path)
    log_scales = log_scales.clip(-LARGEST_LOG_SCALE, LARGEST_LOG_SCALE)
    fields = {
        "packed_position": means,
        "packed_scale": log_scales,
        "packed_color": 0.5 + SH0 * sh[:, 0],
    }
    bounded = {word: _within_chunks(values) for word, values in fields.items()}
    names = [name for word in fields for name in BOUNDS[word]]
    chunk = np.concatenate([ends for ends, _ in bounded.values()], axis=1).astype("<f4")
    index, rest = drop_largest(quats)
    colour = [bounded["packed_color"][1], opacity_bytes(gaussians)[:, None] / 255]
    vertex = np.empty(len(gaussians), [(word, "<u4") for word in WORDS])
    vertex["packed_position"] = _join(bounded["packed_position"][1], XYZ_BITS)
    vertex["packed_rotation"] = _join(rest / np.sqrt(2) + 0.5, QUAT_BITS) | index << 30
    vertex["packed_scale"] = _join(bounded["packed_scale"][1], XYZ_BITS)
    vertex["packed_color"] = _join(np.concatenate(colour, axis=1), RGBA_BITS)
    elements = {"chunk": Rows.of(_records(chunk, names)), "vertex": Rows.of(vertex)}
    if gaussians.sh_degree > 0:
        rounded = np.floor((sh[:, 1:] / (2 * SH_RANGE) + 0.5) * 256).clip(0, 255).astype("u1")
        table = np.ascontiguousarray(rounded.transpose(0, 2, 1)).reshape(len(gaussians), -1)
        elements["sh"] = Rows.of(_records(table, [f"f_rest_{i}" for i in range(table.shape[1])]))
    write_elements(path, elements, [*vertical_comments(gaussians), *comments])


def _within_chunks(values: Array) -> tuple[Array, Array]:
    """Bounds of each chunk (c, 6), the least first, and where in them each value lies (n, 3)."""
    begins = np.arange(0, len(values), CHUNK)
    # Rounded as they are stored, so that fractions are of the bounds that readers see.
    low = np.minimum.reduceat(values, begins).astype(np.float32).astype(np.float64)
    high = np.maximum.reduceat(values, begins).astype(np.float32).astype(np.float64)
    extent = np.where(high > low, high - low, 1.0)
    chunk = np.arange(len(values)) // CHUNK
    return np.concatenate([low, high], axis=1), (values - low[chunk]) / extent[chunk]


def _split(words: NDArray[Any], bits: Sequence[int]) -> Array:
    """The lowest fields of 32-bit words, the first the highest, each as a part of its largest."""
    shifts = sum(bits) - np.cumsum(bits)
    masks = 2 ** np.array(bits) - 1
    return (words.astype(np.int64)[:, None] >> shifts & masks) / masks


def _join(fractions: Array, bits: Sequence[int]) -> NDArray[np.int64]:
    """The inverse of :func:`_split`, fractions clipped to [0, 1]."""
    shifts = sum(bits) - np.cumsum(bits)
    whole = np.round(fractions.clip(0, 1) * (2 ** np.array(bits) - 1)).astype(np.int64)
    return (whole << shifts).sum(axis=1)


def _harmonics(stored: Columns, n: int, path: str | Path) -> Array:
    names = [f"f_rest_{i}" for i in range(len(stored))]
    if len(names) not in (0, 9, 24, 45) or set(names) != set(stored):
        raise ReadError(
            f"{path} has {len(names)} harmonics a splat, expected 0, 9, 24 or 45 (f_rest_0 and on)"
            ": export it again"
        )
    if not names:
        return np.empty((n, 0, 3))
    if len(stored["f_rest_0"]) != n:
        raise ReadError(
            f"{path} has harmonics for {len(stored['f_rest_0'])} of {n} splats: export it again"
        )
    values = np.stack([stored[name] for name in names], axis=1).astype(np.float64)
    fractions = np.select([values == 0, values == 255], [0.0, 1.0], (values + 0.5) / 256)
    return ((fractions - 0.5) * 2 * SH_RANGE).reshape(n, 3, -1).transpose(0, 2, 1)


def _records(table: NDArray[Any], names: Sequence[str]) -> NDArray[Any]:
    return table.view([(name, table.dtype) for name in names])[:, 0]
