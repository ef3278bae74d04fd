"""The rasterizer for CPUs, in C++ with vector types.

The headers beside this file are the body of one function, in the order of ``layout.HEADERS``.
All threads run it at once and share the frame's tasks (``frame.h``). The memory of a frame is
kept for the next one.
"""

from __future__ import annotations

import ctypes
import math
import os
import threading
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.cpp import cores
from renderer.native import layout
from renderer.native.layout import MAX_CHANNELS, PARTS, PROGRAM, STAGES
from renderer.views import View

__all__ = ["MAX_CHANNELS", "PROGRAM", "STAGES", "gather", "render", "stage_shares"]

Array = NDArray[Any]

CACHE_LINE = 64
STATE_BYTES = ctypes.sizeof(layout.State)
LIST_ENTRIES = 1 << 22
"""Entries of the tile lists at a time, 16 bytes each with their sorted copy."""


class _Memory:
    """The arrays of a frame, grown as needed and kept; one frame at a time draws with them."""

    def __init__(self) -> None:
        self.drawing = threading.Lock()
        self.state = layout.State.from_buffer(_aligned((STATE_BYTES,), np.uint8).data)
        self.arrays: dict[str, Array] = {}

    def fit(self, n: int, rows: int, columns: int) -> dict[str, int]:
        """Make room for n splats on so many tiles: arguments by name."""
        tiles = rows * columns
        list_size = max(LIST_ENTRIES // PARTS, tiles + 5)
        room = tiles + columns + 1
        sizes = {
            "splats": n * layout.SPLAT_BYTES,
            "keys": 2 * n * 4,
            "ids": 2 * n * 4,
            "digits": PARTS * 4 << layout.RADIX_BITS,
            "counts": PARTS * room * 4,
            "ends": tiles * 4,
            "lists": PARTS * list_size * layout.ENTRY_BYTES,
            "entries": PARTS * list_size * layout.ENTRY_BYTES,
            "kept": tiles * layout.BLOCKS * layout.BLOCK_BYTES,
            "open_blocks": room * layout.TILE_BYTES,
        }
        for name, size in sizes.items():
            if name not in self.arrays or len(self.arrays[name]) < size:
                self.arrays[name] = _aligned((size,), np.uint8)
        addresses = {name: self.arrays[name].ctypes.data for name in sizes}
        return {**addresses, "list_size": list_size}


def _aligned(shape: tuple[int, ...], dtype: Any) -> Array:
    """An uninitialised array at the start of a cache line."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    raw = np.empty(size + CACHE_LINE, np.uint8)
    skip = -raw.ctypes.data % CACHE_LINE
    return raw[skip : skip + size].view(dtype).reshape(shape)


_memory = _Memory()


def _forget() -> None:
    """A child doesn't wait for a frame that a thread of its parent was drawing."""
    global _memory
    _memory = _Memory()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)


def stage_shares() -> dict[str, float]:
    """The share of each stage in the processor time of the last frame."""
    ticks = np.array(_memory.state.ticks, float)
    return dict(zip(STAGES, ticks / max(ticks.sum(), 1), strict=True))


def render(
    scene: Mapping[str, Array],
    degree: int,
    views: Sequence[View],
    background: Array,
    share: float = 0.0,
    threads: int | None = None,
) -> tuple[Array, Array, Array]:
    """rgb (c, h, w, 3), alpha (c, h, w) and depth (c, h, w) of c views of one size.

    ``scene`` holds the arrays of ``rasterize`` by name, float32 and in C order; the depth is that
    at which ``share`` of the alpha is gathered, at 0 the mean.
    """
    n, coefficients = scene["sh"].shape[:2]
    height, width = views[0].height, views[0].width
    shape = (len(views), height, width)
    made = {"rgb": (*shape, 3), "alpha": shape, "depth": shape}
    pictures = {name: _aligned(size, np.float32) for name, size in made.items()}
    rows, columns = -(-height // layout.ROWS), -(-width // layout.COLUMN)
    memory = _memory
    with memory.drawing:
        arguments = layout.Arguments(
            **{name: array.ctypes.data for name, array in scene.items()},
            **memory.fit(n, rows, columns),
            state=ctypes.addressof(memory.state),
            background=tuple(background),
            share=share,
            n=n,
            coefficients=coefficients,
            degree=degree,
        )
        for i, view in enumerate(views):
            for name, picture in pictures.items():
                setattr(arguments, name, picture[i].ctypes.data)
            _run(arguments, view, memory, threads)
    return pictures["rgb"], pictures["alpha"], pictures["depth"]


def gather(
    scene: Mapping[str, Array],
    views: Sequence[View],
    pictures: Array,
    grain: float,
    threads: int | None = None,
) -> Array:
    """What splats add to the pixels of c views, times ``pictures`` (c, h, w, k), k ≤ MAX_CHANNELS.

    Returns the sums (n, k) over views and pixels, int64 in 1/grain.
    """
    n, channels = len(scene["means"]), pictures.shape[-1]
    height, width = views[0].height, views[0].width
    rows, columns = -(-height // layout.ROWS), -(-width // layout.COLUMN)
    whole = np.zeros((rows * layout.ROWS, columns * layout.COLUMN, channels), np.float32)
    side = layout.SIDE
    down, across = layout.ROWS // side, layout.COLUMN // side
    tiled = _aligned((rows, columns, across, down, channels, side, side), np.float32)
    sums = np.zeros((n, channels), np.int64)
    memory = _memory
    with memory.drawing:
        arguments = layout.Arguments(
            **{name: array.ctypes.data for name, array in scene.items()},
            **memory.fit(n, rows, columns),
            state=ctypes.addressof(memory.state),
            pictures=tiled.ctypes.data,
            gathered=sums.ctypes.data,
            grain=grain,
            n=n,
            coefficients=1,
            channels=channels,
        )
        for view, picture in zip(views, pictures, strict=True):
            whole[:height, :width] = picture
            split = whole.reshape(rows, down, side, columns, across, side, channels)
            tiled[:] = split.transpose(0, 3, 4, 1, 6, 2, 5)
            _run(arguments, view, memory, threads)
    return sums


def _run(arguments: layout.Arguments, view: View, memory: _Memory, threads: int | None) -> None:
    """One view; ``memory`` is held by the caller."""
    arguments.view = layout.View(*view)
    # The first phase, projection, with a task a part; see the ticket in ``frame.h``.
    ctypes.memset(arguments.state, 0, STATE_BYTES)
    memory.state.ticket = PARTS << 28
    PROGRAM.run(arguments, threads or cores())
