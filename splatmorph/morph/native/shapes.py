"""``shapes.h``, compiled once for each dtype, with and without stretch."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from renderer.cpp import Program
from splatmorph.morph.covariance import LEAST, NEWTON_STEP, PARALLEL, SWEEPS

STORED = {"float32": "float", "float64": "double"}
"""What the compiler calls the dtypes that are taken."""


class _Arguments(ctypes.Structure):
    """The twin of the one in ``shapes.h``."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("quats_in", "log_scales_in", "jacobians")),
        *((name, ctypes.c_void_p) for name in ("quats_out", "log_scales_out", "turns_out")),
        *((name, ctypes.c_int64) for name in ("knots", "count")),
        ("strides", ctypes.c_int64 * 4),
    )


@cache
def _program(dtype: str, stretch: bool) -> Program:
    constants = (
        f"typedef {STORED[dtype]} Stored; constexpr int STRETCH = {int(stretch)};\n"
        f"constexpr int SWEEPS = {SWEEPS};\n"
        f"constexpr double LEAST = {LEAST!r}, PARALLEL = {PARALLEL!r};\n"
        f"constexpr double NEWTON_STEP = {NEWTON_STEP!r};\n"
    )
    here = Path(__file__).parent
    return Program(here, ("shapes.h",), _Arguments, constants=constants, dtype=dtype)


def takes(quats: Tensor, jacobians: Tensor, *, stretch: bool) -> bool:
    """Whether the shapes are for ``carried_shapes``."""
    dtype = _name(quats.dtype)
    return (
        dtype in STORED
        and jacobians.dtype == quats.dtype
        and _program(dtype, stretch).takes(quats, jacobians)
    )


def _name(dtype: torch.dtype) -> str:
    return str(dtype).removeprefix("torch.")


def carried_shapes(
    quats: Tensor, log_scales: Tensor, jacobians: Tensor, *, stretch: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """As its plain twin, on all of torch's threads; for tensors as ``takes`` wants them."""
    knots, count = jacobians.shape[:2]
    inputs = (quats.contiguous(), log_scales.contiguous(), jacobians)
    quats_out, turns_out = (quats.new_empty(knots, count, 4) for _ in range(2))
    outputs = quats_out, quats.new_empty(knots, count, 3), turns_out
    addresses = (tensor.data_ptr() for tensor in (*inputs, *outputs))
    strides = (ctypes.c_int64 * 4)(*jacobians.stride())
    arguments = _Arguments(*addresses, knots, count, strides)
    _program(_name(quats.dtype), stretch).run(arguments, torch.get_num_threads())
    return outputs
