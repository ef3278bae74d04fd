"""tps: the baseline of a thin-plate displacement, scaled by t."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from splatmorph.flows.base import Flow, as_column
from splatmorph.flows.spline import SplineField


class ThinPlate(Flow):
    """Φ(x, t) = x + t · s(x) for t ≥ 0 and x + |t| · r(x) for t ≤ 0.

    s is the thin-plate spline that takes the source landmarks to the target's, r the one that
    takes them back. Every landmark is met, but neither is the inverse of the other, and nothing
    keeps either from folding.
    """

    kind = "tps"

    def __init__(self, dim: int, *, centers: int = 0) -> None:
        super().__init__(dim)
        self.onward = SplineField(dim, centers=centers, rounding=1e-9)
        self.back = SplineField(dim, centers=centers, rounding=1e-9)

    def config(self) -> dict[str, Any]:
        """Kind, dimension and the number of landmarks."""
        return {**super().config(), "centers": len(self.onward.centers)}

    def unit_velocity(self, u: Tensor) -> Tensor:
        """s(u): the velocity at t = 0 from above."""
        return self.onward(u)

    def unit_velocity_jacobian(self, u: Tensor) -> Tensor:
        """∂s/∂u."""
        return self.onward.jacobian(u)

    def unit_forward(self, u: Tensor, t: float | Tensor) -> Tensor:
        """Φ(u, t) in the frame."""
        column = as_column(t, u)
        return u + column.clamp_min(0) * self.onward(u) + (-column).clamp_min(0) * self.back(u)

    def unit_trajectory(
        self, u: Tensor, times: list[float], *, jacobian: bool
    ) -> tuple[Tensor, Tensor | None]:
        """Φ(u, t) for every t and, where asked, ∂Φ/∂u; each spline is evaluated once."""
        ts = u.new_tensor(times)[:, None, None]
        sides = [
            (side, weight)
            for side, weight in ((self.onward, ts.clamp_min(0)), (self.back, (-ts).clamp_min(0)))
            if bool(weight.any())
        ]
        moved = u.expand(len(times), *u.shape).clone()
        for side, weight in sides:
            moved += weight * side(u)
        if not jacobian:
            return moved, None
        identity = torch.eye(self.dim).to(u)
        slopes = identity.expand(len(times), len(u), self.dim, self.dim).clone()
        for side, weight in sides:
            slopes += weight[..., None] * side.jacobian(u)
        return moved, slopes
