# mypy: ignore-errors
# Warp's annotations are values, which a type checker can't read.
"""``path.h`` as Warp kernels, one for each dimension, with and without Jacobians."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import torch

from renderer.quietly import wp
from renderer.threads import launch_parts
from splatmorph.flows.siren import SirenField
from splatmorph.flows.spline import SplineField

MOST_WIDTH = 256
"""Widest network that ``path.h`` has room for."""
WIDTH_STEP = 4
WORTH_SHARING = 64
"""Points from which a second thread pays."""


class _Arguments(ctypes.Structure):
    """The twin of the one in ``path.h``."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("starts", "affine", "spline", "network")),
        *((name, ctypes.c_void_p) for name in ("states", "rates")),
        *((name, ctypes.c_int64) for name in ("points", "centers", "width", "steps", "every")),
        *((name, ctypes.c_double) for name in ("rounding_squared", "h")),
    )


@cache
def _kernel(dim: int, jacobian: bool):
    folder = Path(__file__).parent
    lanes, path = ((folder / name).read_text(encoding="utf-8") for name in ("lanes.h", "path.h"))
    constants = f"constexpr int DIM = {dim}, JACOBIAN = {int(jacobian)};\n"

    @wp.func_native(constants + lanes + path)
    def integrate_natively(arguments: wp.uint64, parts: int, part: int): ...

    @wp.kernel(enable_backward=False, module="unique")
    def integrate(arguments: wp.uint64, parts: int, part: int):
        integrate_natively(arguments, parts, part)

    return integrate


def takes(field: SplineField | SirenField) -> bool:
    """Whether ``path.h`` knows the field."""
    return isinstance(field, SplineField) or (
        field.activation == "sine"
        and field.depth == 2
        and field.width <= MOST_WIDTH
        and field.width % WIDTH_STEP == 0
    )


def knots(
    field: SplineField | SirenField,
    u: torch.Tensor,
    h: float,
    steps: int,
    *,
    jacobian: bool,
    every: bool = True,
) -> tuple[torch.Tensor, torch.Tensor]:
    """States and rates after 0 … ``steps`` Runge-Kutta steps of size h, on all of torch's threads.

    ``u`` is (m, dim) float32 on the CPU. -> twice (steps + 1, m, dim or dim + dim²); where not
    ``every``, only the last state (1, m, …) and rates that mean nothing.
    """
    count, dim = u.shape
    state = dim + dim * dim * jacobian
    saved = steps + 1 if every else 1
    states = torch.empty(saved, count, state)
    rates = torch.empty_like(states) if every else states
    base = field if isinstance(field, SplineField) else field.base
    network = torch.zeros(1) if field is base else _packed(field)
    arrays = [
        tensor.detach().float().contiguous()
        for tensor in (u, base.affine, torch.cat([base.centers, base.weights], 1), network)
    ]
    width = 0 if field is base else field.width
    arguments = _Arguments(
        *(array.data_ptr() for array in (*arrays, states, rates)),
        *(count, len(base.centers), width, steps, every),
        *(base.rounding**2, h),
    )
    parts = 1 if count < WORTH_SHARING else torch.get_num_threads()
    launch_parts(_kernel(dim, jacobian), [ctypes.addressof(arguments)], parts)
    return states, rates


def _packed(field: SirenField) -> torch.Tensor:
    first, second, last = field.network.weights
    first_bias, second_bias, last_bias = field.network.biases
    scales = field.network.omegas
    hidden = [
        torch.cat([weight, bias[:, None]], dim=1) * omega
        for weight, bias, omega in zip(
            (first, second), (first_bias, second_bias), scales, strict=True
        )
    ]
    return torch.cat([part.flatten() for part in (*hidden, last.T, last_bias)])
