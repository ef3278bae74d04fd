"""linear: no warp at all, so that a morph is a linear blend."""

from __future__ import annotations

import torch
from torch import Tensor

from splatmorph.flows.base import Flow


class Linear(Flow):
    """Φ(x, t) = x: what a warp is compared with."""

    kind = "linear"

    def unit_velocity(self, u: Tensor) -> Tensor:
        """Zero."""
        return torch.zeros_like(u)

    def unit_velocity_jacobian(self, u: Tensor) -> Tensor:
        """Zero."""
        return u.new_zeros(len(u), self.dim, self.dim)

    def unit_forward(self, u: Tensor, t: float | Tensor) -> Tensor:
        """u itself."""
        return u

    def unit_trajectory(
        self, u: Tensor, times: list[float], *, jacobian: bool
    ) -> tuple[Tensor, Tensor | None]:
        """u at every t, the identity as its Jacobian."""
        moved = u.expand(len(times), *u.shape).clone()
        if not jacobian:
            return moved, None
        identity = torch.eye(self.dim).to(u)
        return moved, identity.expand(len(times), len(u), self.dim, self.dim).clone()
