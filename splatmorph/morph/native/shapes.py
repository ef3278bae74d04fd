"""``shapes.h``, compiled once for each dtype, with and without stretch."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from renderer.snippet import run_snippet
from splatmorph.morph.covariance import LEAST, NEWTON_STEP, PARALLEL, SWEEPS

STORED = {torch.float32: "float", torch.float64: "double"}


class _Arguments(ctypes.Structure):
    """The twin of the one in ``shapes.h``."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("quats_in", "log_scales_in", "jacobians")),
        *((name, ctypes.c_void_p) for name in ("quats_out", "log_scales_out", "turns_out")),
        *((name, ctypes.c_int64) for name in ("knots", "count")),
        ("strides", ctypes.c_int64 * 4),
    )


@cache
def _source(dtype: torch.dtype, stretch: bool) -> str:
    constants = (
        f"typedef {STORED[dtype]} Stored; constexpr int STRETCH = {int(stretch)};\n"
        f"constexpr int SWEEPS = {SWEEPS};\n"
        f"constexpr double LEAST = {LEAST!r}, PARALLEL = {PARALLEL!r};\n"
        f"constexpr double NEWTON_STEP = {NEWTON_STEP!r};\n"
    )
    return constants + Path(__file__).with_name("shapes.h").read_text(encoding="utf-8")


def carried_shapes(
    quats: Tensor, log_scales: Tensor, jacobians: Tensor, *, stretch: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """As its plain twin, on all of torch's threads; tensors on the CPU, of one dtype."""
    knots, count = jacobians.shape[:2]
    inputs = (quats.contiguous(), log_scales.contiguous(), jacobians)
    quats_out, turns_out = (quats.new_empty(knots, count, 4) for _ in range(2))
    outputs = quats_out, quats.new_empty(knots, count, 3), turns_out
    addresses = (tensor.data_ptr() for tensor in (*inputs, *outputs))
    strides = (ctypes.c_int64 * 4)(*jacobians.stride())
    arguments = _Arguments(*addresses, knots, count, strides)
    run_snippet(_source(quats.dtype, stretch), arguments, torch.get_num_threads())
    return outputs
