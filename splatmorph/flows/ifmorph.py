"""ifmorph: the baseline whose network is the warp itself, a flow by penalty only."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from splatmorph.flows.base import Flow
from splatmorph.flows.jets import Jet
from splatmorph.flows.network import Network


class Ifmorph(Flow):
    """Φ(x, t) = network(x, t) for t in [-1, 1] (Schardong et al. 2024).

    Nothing makes it a flow: identity, inverse and group law hold as far as the penalties went.
    """

    kind = "ifmorph"

    def __init__(
        self, dim: int, *, width: int = 128, activation: str = "sine", omega: float = 6.0
    ) -> None:
        super().__init__(dim)
        self.options = {"width": width, "activation": activation, "omega": omega}
        self.network = Network(
            [dim + 1, width, width, dim],
            activation=activation,
            first_omega=omega,
            omega=omega,
            output_scale=1.0,
        )

    def config(self) -> dict[str, Any]:
        """Kind, dimension and the network's options."""
        return {**super().config(), **self.options}

    def unit_velocity(self, u: Tensor) -> Tensor:
        """∂Φ/∂t(u, 0) in the frame."""
        along_t = _joint(u, 0.0).new_zeros(1, len(u), self.dim + 1)
        along_t[..., -1] = 1
        return self.network.push(Jet(_joint(u, 0.0), along_t)).first[0]

    def unit_velocity_jacobian(self, u: Tensor) -> Tensor:
        """∂²Φ/∂u∂t(u, 0) in the frame."""
        return self.network.push(Jet.seed(_joint(u, 0.0))).hessian()[:, :, : self.dim, self.dim]

    def unit_forward(self, u: Tensor, t: float | Tensor) -> Tensor:
        """Φ(u, t) in the frame."""
        return self.network(_joint(u, t))

    def unit_trajectory(
        self, u: Tensor, times: list[float], *, jacobian: bool
    ) -> tuple[Tensor, Tensor | None]:
        """Φ(u, t) for every t and, where asked, ∂Φ/∂u."""
        if not times:
            return u.new_empty(0, *u.shape), u.new_empty(0, *u.shape, self.dim)
        if not jacobian:
            return torch.stack([self.unit_forward(u, t) for t in times]), None
        jets = [self.network.push(Jet.seed(_joint(u, t), order=1)) for t in times]
        return (
            torch.stack([jet.value for jet in jets]),
            torch.stack([jet.jacobian()[:, :, : self.dim] for jet in jets]),
        )


def _joint(u: Tensor, t: float | Tensor) -> Tensor:
    column = torch.as_tensor(t, dtype=u.dtype, device=u.device).expand(len(u))
    return torch.cat([u, column[:, None]], dim=1)
