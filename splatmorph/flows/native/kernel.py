# mypy: ignore-errors
# Warp's annotations are values, which a type checker can't read.
"""``path.h`` as Warp kernels, one for each dimension, with and without Jacobians."""

from __future__ import annotations

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


@cache
def _kernel(dim: int, jacobian: bool):
    folder = Path(__file__).parent
    lanes, path = ((folder / name).read_text(encoding="utf-8") for name in ("lanes.h", "path.h"))
    constants = f"constexpr int DIM = {dim}, JACOBIAN = {int(jacobian)};\n"

    @wp.func_native(constants + lanes + path)
    def integrate_natively(
        starts: wp.array(dtype=float),
        affine: wp.array(dtype=float),
        spline: wp.array(dtype=float),
        network: wp.array(dtype=float),
        states: wp.array(dtype=float),
        rates: wp.array(dtype=float),
        count: int,
        width: int,
        rounding_squared: float,
        h: float,
        steps: int,
        every: int,
        parts: int,
        part: int,
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def integrate(
        starts: wp.array(dtype=float),
        affine: wp.array(dtype=float),
        spline: wp.array(dtype=float),
        network: wp.array(dtype=float),
        states: wp.array(dtype=float),
        rates: wp.array(dtype=float),
        count: int,
        width: int,
        rounding_squared: float,
        h: float,
        steps: int,
        every: int,
        parts: int,
        part: int,
    ):
        integrate_natively(
            starts,
            affine,
            spline,
            network,
            states,
            rates,
            count,
            width,
            rounding_squared,
            h,
            steps,
            every,
            parts,
            part,
        )

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
        wp.from_torch(tensor.detach().float().contiguous().flatten())
        for tensor in (u, base.affine, torch.cat([base.centers, base.weights], 1), network)
    ]
    outputs = [wp.from_torch(tensor.flatten()) for tensor in (states, rates)]
    width = 0 if field is base else field.width
    scalars = [len(base.centers), width, base.rounding**2, h, steps, int(every)]
    parts = 1 if count < WORTH_SHARING else torch.get_num_threads()
    launch_parts(_kernel(dim, jacobian), [*arrays, *outputs, *scalars], parts)
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
