"""NODE: the flow of a velocity field, integrated by the classical Runge-Kutta method."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Self

import torch
from torch import Tensor

from splatmorph.errors import OptionError
from splatmorph.flows.base import Flow, as_column, check_options, options_of
from splatmorph.flows.native import path
from splatmorph.flows.siren import SirenField
from splatmorph.flows.spline import SplineField

Field = SplineField | SirenField

FIELDS: Mapping[str, type[Field]] = {field.name: field for field in (SplineField, SirenField)}
"""The velocity fields that can be named."""

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

    @classmethod
    def make(
        cls,
        dim: int,
        *,
        field: str = SplineField.name,
        steps: int = DEFAULT_STEPS,
        **options: Any,
    ) -> Self:
        """An unfitted flow in R^dim; ``field`` is one of ``FIELDS``, ``options`` are the field's.

        Raises:
            OptionError: there is no such field or option.
        """
        if field not in tuple(FIELDS):
            raise OptionError(f"field '{field}' is unknown: choose one of {', '.join(FIELDS)}")
        known = {"steps": DEFAULT_STEPS, "field": field, **options_of(FIELDS[field])}
        what = f"flow '{cls.kind}' with a {field} field"
        check_options(what, {"steps": steps, **options}, known)
        if steps < 1:
            raise OptionError(f"{what}: steps is {steps}, expected at least 1")
        return cls(dim, FIELDS[field](dim, **options), steps)

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
        if count and column.ndim == 0 and path.takes(self.field, u, jacobian=False):
            h = float(column) / count
            return path.states(self.field, u, h, count, jacobian=False, every=count)[-1]
        return runge_kutta(self.field, u, column, count)

    def unit_trajectory(
        self, u: Tensor, times: list[float], *, jacobian: bool
    ) -> tuple[Tensor, Tensor | None]:
        """Φ(u, t) for every t and, where asked, the Jacobian carried along the path."""
        every = _steps_between(times, self.steps)
        if every and path.takes(self.field, u, jacobian=jacobian):
            h, count = math.copysign(1 / self.steps, every), abs(every) * len(times)
            out = path.states(self.field, u, h, count, jacobian=jacobian, every=abs(every))[1:]
        else:
            out = self._between_knots(u, times, jacobian)
        if not jacobian:
            return out, None
        return out[..., : self.dim], out[..., self.dim :].unflatten(2, (self.dim, self.dim))

    def _between_knots(self, u: Tensor, times: list[float], jacobian: bool) -> Tensor:
        """The states at any times."""
        start = _joint(u, jacobian)
        out = start.expand(len(times), *start.shape).clone()
        for sign in (1.0, -1.0):
            wanted = [(sign * t * self.steps, i) for i, t in enumerate(times) if sign * t > 0]
            if wanted:
                count = math.ceil(max(wanted)[0] - 1e-9)
                _dense_output(
                    out, wanted, *self._knots(u, sign, count, jacobian), sign / self.steps
                )
        return out

    def _knots(self, u: Tensor, sign: float, count: int, jacobian: bool) -> tuple[Tensor, Tensor]:
        """States and rates at the knots 0, 1/steps, … count/steps, forwards or backwards."""
        if path.takes(self.field, u, jacobian=jacobian):
            return path.knots(self.field, u, sign / self.steps, count, jacobian=jacobian)
        rates = self._rates(jacobian)
        states = [_joint(u, jacobian)]
        slopes = [rates(states[0])]
        for _ in range(count):
            states.append(runge_kutta_step(rates, states[-1], sign / self.steps, slopes[-1]))
            slopes.append(rates(states[-1]))
        return torch.stack(states), torch.stack(slopes)

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


def _steps_between(times: list[float], steps: int) -> int:
    """So many steps, backwards if negative, lie before each of ``times``; 0: not the same."""
    every = round(times[0] * steps) if times else 0
    even = all(t * steps == every * (k + 1) for k, t in enumerate(times))
    return every if even else 0


def _dense_output(
    out: Tensor, wanted: list[tuple[float, int]], states: Tensor, rates: Tensor, h: float
) -> None:
    """Fill out[i] at every wanted (time in steps, i) by the cubic of the interval it lies in."""
    for position, i in wanted:
        knot = min(int(position), len(states) - 2)
        s = position - knot
        # Hermite's basis, in passes that need no memory of their own.
        torch.mul(states[knot], (1 + 2 * s) * (1 - s) ** 2, out=out[i])
        out[i].add_(states[knot + 1], alpha=s * s * (3 - 2 * s))
        out[i].add_(rates[knot], alpha=h * s * (1 - s) ** 2)
        out[i].add_(rates[knot + 1], alpha=h * s * s * (s - 1))
