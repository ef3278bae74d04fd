"""``path.h``, compiled once for each dimension, with and without Jacobians."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import torch

from renderer.cpp import Program
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
def _program(dim: int, jacobian: bool) -> Program:
    sizes = f"DIM = {dim}, JACOBIAN = {int(jacobian)}, MOST_WIDTH = {MOST_WIDTH}"
    return Program(
        Path(__file__).parent,
        ("lanes.h", "path.h"),
        _Arguments,
        constants=f"constexpr int {sizes};",
    )


def takes(field: SplineField | SirenField, u: torch.Tensor, *, jacobian: bool) -> bool:
    """Whether the paths of the points ``u`` (m, dim) are for ``knots``."""
    known = isinstance(field, SplineField) or (
        field.activation == "sine"
        and field.depth == 2
        and field.width <= MOST_WIDTH
        and field.width % WIDTH_STEP == 0
    )
    return known and _program(u.shape[1], jacobian).takes(u, *field.parameters())


def knots(
    field: SplineField | SirenField,
    u: torch.Tensor,
    h: float,
    steps: int,
    *,
    jacobian: bool,
) -> tuple[torch.Tensor, torch.Tensor]:
    """States and rates after 0 … ``steps`` Runge-Kutta steps of size h, on all of torch's threads.

    ``u`` (m, dim) as ``takes`` wants it. -> twice (steps + 1, m, dim or dim + dim²).
    """
    states = torch.empty(steps + 1, *_state(u, jacobian))
    rates = torch.empty_like(states)
    _run(field, u, h, steps, jacobian, states, rates)
    return states, rates


def states(
    field: SplineField | SirenField,
    u: torch.Tensor,
    h: float,
    steps: int,
    *,
    jacobian: bool,
    every: int,
) -> torch.Tensor:
    """The states of ``knots`` after each ``every`` steps, of which ``steps`` is a multiple."""
    found = torch.empty(steps // every + 1, *_state(u, jacobian))
    _run(field, u, h, steps, jacobian, found, None)
    return found


def _state(u: torch.Tensor, jacobian: bool) -> tuple[int, int]:
    count, dim = u.shape
    return count, dim + dim * dim * jacobian


def _run(
    field: SplineField | SirenField,
    u: torch.Tensor,
    h: float,
    steps: int,
    jacobian: bool,
    states: torch.Tensor,
    rates: torch.Tensor | None,
) -> None:
    count, dim = u.shape
    if isinstance(field, SplineField):
        base, network, width = field, torch.zeros(1), 0
    else:
        base, network, width = field.base, _packed(field), field.width
    arrays = [
        tensor.detach().float().contiguous()
        for tensor in (u, base.affine, torch.cat([base.centers, base.weights], 1), network)
    ]
    arguments = _Arguments(
        *(array.data_ptr() for array in (*arrays, states)),
        None if rates is None else rates.data_ptr(),
        *(count, len(base.centers), width, steps, steps // (len(states) - 1)),
        *(base.rounding**2, h),
    )
    parts = 1 if count < WORTH_SHARING else torch.get_num_threads()
    _program(dim, jacobian).run(arguments, parts)


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
