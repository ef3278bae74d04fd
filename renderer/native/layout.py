"""What Python and the headers both know: sizes of tiles and parts, and the twins of structs."""

from __future__ import annotations

import ctypes
import math
from pathlib import Path

from renderer import reference
from renderer.cpp import Program

SIDE = 4
"""Pixels along a block, whose square are the lanes of a vector."""
COLUMN = 16
"""Pixels across a tile: four blocks."""
ROWS = 64
"""Pixels down a tile: sixteen blocks, so that the blocks of a tile are the bits of a word."""
BLOCKS = COLUMN * ROWS // SIDE**2
PARTS = 16
"""Into how many tasks a stage is split, for any number of threads."""
RADIX_BITS = 12
MAX_CHANNELS = 8
"""Values a pixel that are gathered in one pass."""

SPLAT_BYTES = 64
ENTRY_BYTES = 8
TILE_BYTES = 16
BLOCK_BYTES = 5 * 4 * SIDE**2

STAGES = ("project", "count digits", "sort", "list and colour", "fill", "blend")

HEADERS = ("vectors.h", "memory.h", "project.h", "sort.h", "shade.h", "bin.h", "blend.h", "frame.h")

# 2^f for f in [-1/2, 1/2]: minimax cubic in relative error, 7.5e-5.
EXP = (9.99928027e-01, 6.93260970e-01, 2.42611372e-01, 5.51717746e-02)

CONSTANTS = f"""
constexpr int SIDE = {SIDE}, COLUMN = {COLUMN}, ROWS = {ROWS}, BLOCKS = {BLOCKS};
constexpr int PARTS = {PARTS}, RADIX_BITS = {RADIX_BITS}, RADIX = 1 << RADIX_BITS;
constexpr int MAX_CHANNELS = {MAX_CHANNELS};
constexpr float BLUR = {reference.BLUR}f, ALPHA_MIN = 1.f / 255;
constexpr float LOG2_E = {math.log2(math.e)}f, LOG2_ALPHA_MIN = {math.log2(reference.ALPHA_MIN)}f;
constexpr float ALPHA_MAX = {reference.ALPHA_MAX}f, CLEAR_MIN = {reference.TRANSMITTANCE_MIN}f;
constexpr float EXP0 = {EXP[0]}f, EXP1 = {EXP[1]}f, EXP2 = {EXP[2]}f, EXP3 = {EXP[3]}f;
constexpr float SLACK = 1e-3f;  // px, for rounding; blending tests every pixel anyway
"""


class View(ctypes.Structure):
    """``renderer.views.View``."""

    _fields_ = (
        ("viewmat", ctypes.c_float * 16),
        ("to_world", ctypes.c_float * 9),
        *((name, ctypes.c_float * 2) for name in ("focal", "principal", "slope_min", "slope_max")),
        *((name, ctypes.c_float) for name in ("near", "far")),
        *((name, ctypes.c_int) for name in ("width", "height")),
    )


class State(ctypes.Structure):
    """Where a frame is; see ``frame.h``."""

    _fields_ = (
        ("ticket", ctypes.c_uint64),
        *((name, ctypes.c_int) for name in ("finished", "visible", "lowest")),
        *((name, ctypes.c_int) for name in ("pass", "passes", "digit_bits", "sorted")),
        *((name, ctypes.c_int) for name in ("slab_size", "slab_begin", "slab_end")),
        *((name, ctypes.c_int) for name in ("slab_parts", "last_slab", "searching")),
        ("ticks", ctypes.c_uint64 * len(STAGES)),
        ("entries", ctypes.c_int64),
        *((name, ctypes.c_int * PARTS) for name in ("part_count", "part_stop")),
        *((name, ctypes.c_uint * PARTS) for name in ("part_lowest", "part_highest")),
    )


class Arguments(ctypes.Structure):
    """Addresses of arrays, one view, and how much there is of each."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("means", "quats", "scales", "opacities", "sh")),
        *((name, ctypes.c_void_p) for name in ("pictures", "gathered")),
        *((name, ctypes.c_void_p) for name in ("rgb", "alpha", "depth")),
        *((name, ctypes.c_void_p) for name in ("state", "splats", "keys", "ids")),
        *((name, ctypes.c_void_p) for name in ("digits", "counts", "ends")),
        *((name, ctypes.c_void_p) for name in ("lists", "entries", "kept", "open_blocks")),
        ("view", View),
        ("background", ctypes.c_float * 3),
        ("share", ctypes.c_float),
        ("grain", ctypes.c_double),
        *((name, ctypes.c_int) for name in ("n", "coefficients", "degree")),
        *((name, ctypes.c_int) for name in ("channels", "list_size")),
    )


PROGRAM = Program(
    Path(__file__).parent,
    HEADERS,
    Arguments,
    constants=CONSTANTS,
    twins={
        "View": View,
        "State": State,
        "Splat": SPLAT_BYTES,
        "Word": ENTRY_BYTES,
        "Tile": TILE_BYTES,
        "Block": BLOCK_BYTES,
        "Floats": 4 * SIDE**2,
    },
)
