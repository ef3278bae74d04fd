# mypy: ignore-errors
# Warp's annotations are values, which a type checker can't read; here they are local ones, so that
# they can't be kept as text either.
"""``shapes.h`` as Warp kernels, one for each dtype, with and without stretch."""

from functools import cache
from pathlib import Path

import torch

from renderer.quietly import wp
from renderer.threads import launch_parts
from splatmorph.covariance import LEAST, NEWTON_STEP, PARALLEL, SWEEPS

STORED = {torch.float32: ("float", wp.float32), torch.float64: ("double", wp.float64)}


@cache
def _kernel(dtype: torch.dtype, stretch: bool):
    name, stored = STORED[dtype]
    constants = (
        f"typedef {name} Stored; constexpr int STRETCH = {int(stretch)}, SWEEPS = {SWEEPS};\n"
        f"constexpr double LEAST = {LEAST!r}, PARALLEL = {PARALLEL!r};\n"
        f"constexpr double NEWTON_STEP = {NEWTON_STEP!r};\n"
    )
    source = Path(__file__).with_name("shapes.h").read_text(encoding="utf-8")

    @wp.func_native(constants + source)
    def carry_natively(
        quats_in: wp.array2d(dtype=stored),
        log_scales_in: wp.array2d(dtype=stored),
        jacobians: wp.array4d(dtype=stored),
        quats_out: wp.array3d(dtype=stored),
        log_scales_out: wp.array3d(dtype=stored),
        turns_out: wp.array3d(dtype=stored),
        parts: int,
        part: int,
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def carry(
        quats_in: wp.array2d(dtype=stored),
        log_scales_in: wp.array2d(dtype=stored),
        jacobians: wp.array4d(dtype=stored),
        quats_out: wp.array3d(dtype=stored),
        log_scales_out: wp.array3d(dtype=stored),
        turns_out: wp.array3d(dtype=stored),
        parts: int,
        part: int,
    ):
        carry_natively(
            quats_in,
            log_scales_in,
            jacobians,
            quats_out,
            log_scales_out,
            turns_out,
            parts,
            part,
        )

    return carry


def carried_shapes(quats, log_scales, jacobians, *, stretch):
    """As its plain twin, on all of torch's threads; tensors on the CPU, of one dtype."""
    outputs = tuple(quats.new_empty(*jacobians.shape[:2], channels) for channels in (4, 3, 4))
    inputs = (quats.contiguous(), log_scales.contiguous(), jacobians)
    arrays = [wp.from_torch(tensor) for tensor in (*inputs, *outputs)]
    launch_parts(_kernel(quats.dtype, stretch), arrays, torch.get_num_threads())
    return outputs
