"""NODE: the flow of a velocity field, integrated by the classical Runge-Kutta method."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from splatmorph.flows.base import Flow, as_column
from splatmorph.flows.siren import SirenField
from splatmorph.flows.spline import SplineField

Field = SplineField | SirenField

DEFAULT_STEPS = 16
"""Runge-Kutta steps a unit of t, where ``fit`` has not chosen better."""


class Node(Flow):
    """dx/dt = v(x), Φ(x, t) = x + ∫₀ᵗ v(x(τ)) dτ (paper, eq. 4), for a field v of any kind.

    ``steps`` Runge-Kutta steps are taken a unit of t, on the knots k/steps; between knots the
    path is the cubic with the positions and velocities of its ends (dense output of matching
    order), so a whole sequence costs one integration.
    """

    kind = "node"

    def __init__(self, dim: int, field: Field, steps: int = DEFAULT_STEPS) -> None:
        super().__init__(dim)
        self.field = field
        self.steps = steps

    def config(self) -> dict[str, Any]:
        """Kind, dimension, steps and the field with its options."""
        return {
            **super().config(),
            "steps": self.steps,
            "field": self.field.name,
            **self.field.options(),
        }

    def unit_velocity(self, u: Tensor) -> Tensor:
        """v(u) in the frame."""
        return self.field(u)

    def unit_velocity_jacobian(self, u: Tensor) -> Tensor:
        """∂v/∂u in the frame."""
        return self.field.jacobian(u)

    def unit_forward(self, u: Tensor, t: float | Tensor) -> Tensor:
        """Φ(u, t) in the frame, by equal steps of at most 1/steps."""
        column = as_column(t, u)
        if not column.numel():
            return u
        count = math.ceil(float(column.abs().max()) * self.steps - 1e-9)
        return runge_kutta(self.field, u, column, count)

    def unit_trajectory(
        self, u: Tensor, times: list[float], *, jacobian: bool
    ) -> tuple[Tensor, Tensor | None]:
        """Φ(u, t) for every t and, where asked, the Jacobian carried along the path."""
        return _dense_output(
            self._rates(jacobian), _joint(u, jacobian), times, self.steps, self.dim
        )

    def _rates(self, jacobian: bool) -> Callable[[Tensor], Tensor]:
        if not jacobian:
            return self.field
        dim = self.dim

        def rates(state: Tensor) -> Tensor:
            # The variational equation d(∂Φ/∂u)/dt = ∂v/∂u(x) · ∂Φ/∂u beside dx/dt = v(x).
            x, transported = state[:, :dim], state[:, dim:].unflatten(1, (dim, dim))
            return torch.cat([self.field(x), (self.field.jacobian(x) @ transported).flatten(1)], 1)

        return rates


def runge_kutta(
    rates: Callable[[Tensor], Tensor], x: Tensor, t: float | Tensor, steps: int
) -> Tensor:
    """x(t) of dx/dt = rates(x) by ``steps`` classical fourth-order steps; t broadcasts over x."""
    for _ in range(steps):
        x = runge_kutta_step(rates, x, t / steps, rates(x))
    return x


def runge_kutta_step(
    rates: Callable[[Tensor], Tensor], x: Tensor, h: float | Tensor, k1: Tensor
) -> Tensor:
    """One step of size h from x, whose rate k1 is known."""
    k2 = rates(x + 0.5 * h * k1)
    k3 = rates(x + 0.5 * h * k2)
    k4 = rates(x + h * k3)
    return x + (h / 6) * (k1 + 2 * (k2 + k3) + k4)


def _joint(u: Tensor, jacobian: bool) -> Tensor:
    if not jacobian:
        return u
    dim = u.shape[1]
    return torch.cat([u, torch.eye(dim).to(u).flatten().expand(len(u), -1)], dim=1)


def _dense_output(
    rates: Callable[[Tensor], Tensor], start: Tensor, times: list[float], steps: int, dim: int
) -> tuple[Tensor, Tensor | None]:
    out = start.expand(len(times), *start.shape).clone()
    for sign in (1, -1):
        wanted = deque(sorted((sign * t, i) for i, t in enumerate(times) if sign * t > 0))
        if not wanted:
            continue
        x, rate, end = start, rates(start), 0
        while wanted:
            end += 1
            following = runge_kutta_step(rates, x, sign / steps, rate)
            following_rate = rates(following)
            while wanted and wanted[0][0] * steps <= end + 1e-9:
                t, i = wanted.popleft()
                s = t * steps - (end - 1)
                out[i] = _hermite(x, rate, following, following_rate, sign / steps, s)
            x, rate = following, following_rate
    if start.shape[1] == dim:
        return out, None
    return out[..., :dim], out[..., dim:].unflatten(2, (dim, dim))


def _hermite(a: Tensor, va: Tensor, b: Tensor, vb: Tensor, h: float, s: float) -> Tensor:
    # The cubic through a and b with slopes va and vb over an interval of length h, at s in [0, 1].
    rise = b - a
    left, right = h * va - rise, rise - h * vb
    return a + s * (rise + (1 - s) * ((1 - s) * left + s * right))
