"""``path.h`` as Warp kernels, one for each dimension, with and without Jacobians."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import torch

from renderer.snippet import run_snippet
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
def _source(dim: int, jacobian: bool) -> str:
    folder = Path(__file__).parent
    lanes, path = ((folder / name).read_text(encoding="utf-8") for name in ("lanes.h", "path.h"))
    return f"constexpr int DIM = {dim}, JACOBIAN = {int(jacobian)};\n{lanes}{path}"


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
    if isinstance(field, SplineField):
        base, network, width = field, torch.zeros(1), 0
    else:
        base, network, width = field.base, _packed(field), field.width
    arrays = [
        tensor.detach().float().contiguous()
        for tensor in (u, base.affine, torch.cat([base.centers, base.weights], 1), network)
    ]
    arguments = _Arguments(
        *(array.data_ptr() for array in (*arrays, states, rates)),
        *(count, len(base.centers), width, steps, every),
        *(base.rounding**2, h),
    )
    parts = 1 if count < WORTH_SHARING else torch.get_num_threads()
    run_snippet(_source(dim, jacobian), arguments, parts)
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
