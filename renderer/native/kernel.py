# mypy: ignore-errors
# Warp's annotations are values, which a type checker can't read.
"""The C++ of this folder as one Warp kernel."""

from __future__ import annotations

import math
from pathlib import Path

import warp as wp

from renderer import reference
from renderer.kernels import View

COLUMN = 16
"""Pixels across a tile: the lanes of a vector."""
ROWS = 64
"""Pixels down a tile; an entry of the lists holds a row in 6 bits."""
PARTS = 16
"""Into how many tasks a stage is split, for any number of threads."""
RADIX_BITS = 12

PIECES = ("vectors", "memory", "project", "sort", "shade", "bin", "blend", "frame")

# exp(p) for p in [-ln 255 / 16, 0]: minimax cubic in relative error, 4.7e-6.
EXP = (9.99995280e-01, 9.99591826e-01, 4.94252633e-01, 1.39953795e-01)

CONSTANTS = f"""
constexpr int ROWS = {ROWS}, PARTS = {PARTS}, RADIX_BITS = {RADIX_BITS}, RADIX = 1 << RADIX_BITS;
constexpr float BLUR = {reference.BLUR}f, ALPHA_MIN = 1.f / 255;
constexpr float LOG_ALPHA_MIN = {math.log(reference.ALPHA_MIN)}f;
constexpr float ALPHA_MAX = {reference.ALPHA_MAX}f, CLEAR_MIN = {reference.TRANSMITTANCE_MIN}f;
constexpr float EXP0 = {EXP[0]}f, EXP1 = {EXP[1]}f, EXP2 = {EXP[2]}f, EXP3 = {EXP[3]}f;
constexpr float SLACK = 1e-3f;  // px, for rounding; blending tests every pixel anyway
"""

wp.set_module_options({"enable_backward": False})


@wp.struct
class Memory:
    """What a frame needs besides its input and output; see ``memory.h``."""

    state: wp.array(dtype=wp.uint64)
    splats: wp.array(dtype=float)
    keys: wp.array(dtype=wp.uint32)
    ids: wp.array(dtype=int)
    digits: wp.array(dtype=int)
    counts: wp.array(dtype=int)
    ends: wp.array(dtype=int)
    lists: wp.array(dtype=wp.uint64)
    entries: wp.array(dtype=wp.uint64)
    kept: wp.array(dtype=float)
    open_rows: wp.array(dtype=int)


MEMORY_TYPES = {name: member.type.dtype for name, member in Memory.vars.items()}


def _source() -> str:
    folder = Path(__file__).parent
    pieces = [(folder / f"{piece}.h").read_text(encoding="utf-8") for piece in PIECES]
    return "\n".join([CONSTANTS, *pieces])


@wp.func_native(_source())
def draw_natively(
    means_in: wp.array(dtype=float),
    quats_in: wp.array(dtype=float),
    scales_in: wp.array(dtype=float),
    opacities_in: wp.array(dtype=float),
    sh_in: wp.array(dtype=float),
    n: int,
    coefficients: int,
    degree: int,
    view: View,
    background: wp.vec3,
    memory: Memory,
    rgb_out: wp.array(dtype=float),
    alpha_out: wp.array(dtype=float),
    depth_out: wp.array(dtype=float),
): ...


@wp.kernel
def draw(
    means: wp.array(dtype=float),
    quats: wp.array(dtype=float),
    scales: wp.array(dtype=float),
    opacities: wp.array(dtype=float),
    sh: wp.array(dtype=float),
    n: int,
    coefficients: int,
    degree: int,
    view: View,
    background: wp.vec3,
    memory: Memory,
    rgb: wp.array(dtype=float),
    alpha: wp.array(dtype=float),
    depth: wp.array(dtype=float),
):
    draw_natively(
        means,
        quats,
        scales,
        opacities,
        sh,
        n,
        coefficients,
        degree,
        view,
        background,
        memory,
        rgb,
        alpha,
        depth,
    )
