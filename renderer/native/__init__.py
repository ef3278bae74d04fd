"""The rasterizer for CPUs: C++ with vector types, compiled by Warp's own compiler.

The headers beside this file are the body of one function, in the order of ``kernel.PIECES``.
A launch runs on one thread, so a frame is one launch on each thread of a pool, and the
launches share the frame's tasks (``frame.h``). The memory of a frame is kept for the next one.
"""

from __future__ import annotations

import functools
import math
import os
import threading
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from renderer.kernels import View
from renderer.native import kernel
from renderer.threads import together

Array = NDArray[Any]

CACHE_LINE = 64
SPLAT_FLOATS = 16
TILE_FLOATS = 5 * kernel.COLUMN * kernel.ROWS
STATE_WORDS = 64
TICKS_AT = 7
"""The word of the state where the time of each stage is counted; see ``memory.h``."""
STAGES = ("project", "count digits", "sort", "list and colour", "fill", "blend")
LIST_ENTRIES = 1 << 22
"""Entries of the tile lists at a time, 16 bytes each with their sorted copy."""

_drawing = threading.Lock()


@functools.cache
def is_available() -> bool:
    """Whether Warp's compiler knows the vector types and built-ins the headers use."""
    try:
        wp.load_module(kernel, device="cpu")
    except Exception:
        return False
    return bool(kernel.draw.module.execs)


def cores() -> int:
    """The cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _Memory:
    """The arrays of a frame, grown as needed and kept."""

    def __init__(self) -> None:
        self.arrays: dict[str, wp.array] = {}

    def fit(self, n: int, tiles: int) -> kernel.Memory:
        part_entries = max(LIST_ENTRIES // kernel.PARTS, tiles)
        sizes = {
            "state": STATE_WORDS,
            "splats": n * SPLAT_FLOATS,
            "keys": 2 * n,
            "ids": 2 * n,
            "digits": kernel.PARTS << kernel.RADIX_BITS,
            "counts": kernel.PARTS * tiles,
            "ends": tiles,
            "lists": kernel.PARTS * part_entries,
            "entries": kernel.PARTS * part_entries,
            "kept": tiles * TILE_FLOATS,
            "open_rows": 3 * tiles,
        }
        memory = kernel.Memory()
        for name, size in sizes.items():
            array = self.arrays.get(name)
            if array is None or len(array) < size:
                dtype = kernel.MEMORY_TYPES[name]
                numbers = _aligned((size,), wp.dtype_to_numpy(dtype))
                array = self.arrays[name] = wp.array(numbers, dtype=dtype, copy=False, device="cpu")
            setattr(memory, name, array)
        return memory


def _aligned(shape: tuple[int, ...], dtype: Any) -> Array:
    """An uninitialised array at the start of a cache line."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    raw = np.empty(size + CACHE_LINE, np.uint8)
    skip = -raw.ctypes.data % CACHE_LINE
    return raw[skip : skip + size].view(dtype).reshape(shape)


_memory = _Memory()


def stage_shares() -> dict[str, float]:
    """The share of each stage in the processor time of the last frame."""
    ticks = _memory.arrays["state"].numpy()[TICKS_AT : TICKS_AT + len(STAGES)].astype(float)
    return dict(zip(STAGES, ticks / max(ticks.sum(), 1), strict=True))


def render(
    scene: Mapping[str, Array],
    degree: int,
    views: Sequence[View],
    background: Array,
    threads: int | None = None,
) -> tuple[Array, Array, Array]:
    """rgb (c, h, w, 3), alpha (c, h, w) and depth (c, h, w) of c views of one size."""
    n, coefficients = scene["sh"].shape[:2]
    arrays = [_flat(array) for array in scene.values()]
    height, width = views[0].height, views[0].width
    shape = (len(views), height, width)
    rgb, alpha, depth = (_aligned((*shape, *tail), np.float32) for tail in ((3,), (), ()))
    tiles = -(-width // kernel.COLUMN) * -(-height // kernel.ROWS)
    with _drawing:
        memory = _memory.fit(n, tiles)
        for i, view in enumerate(views):
            outputs = [_flat(picture[i]) for picture in (rgb, alpha, depth)]
            inputs = [n, coefficients, degree, view, wp.vec3(*background.tolist()), memory]
            _draw([*arrays, *inputs, *outputs], memory, threads or cores())
    return rgb, alpha, depth


def _flat(array: Array) -> wp.array:
    return wp.array(array.reshape(-1), dtype=float, copy=False, device="cpu")


def _draw(inputs: Sequence[Any], memory: kernel.Memory, threads: int) -> None:
    memory.state.numpy()[:] = 0
    memory.state.numpy()[0] = kernel.PARTS << 28
    frame = wp.launch(kernel.draw, 1, inputs, device="cpu", record_cmd=True)
    together(lambda _: frame.launch(), threads)
