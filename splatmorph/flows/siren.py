"""The SIREN field: the paper's network, on top of an affine or a spline field."""

from __future__ import annotations

from typing import Any, ClassVar

from torch import Tensor, nn

from splatmorph.errors import OptionError
from splatmorph.flows.jets import Jet
from splatmorph.flows.network import Network
from splatmorph.flows.spline import SplineField

BASES = ("spline", "affine")


class SirenField(nn.Module):
    """v(u) = base(u) + network(u), the network dim → width → … → dim with ``depth`` hidden layers.

    The base begins as the least-squares affine velocity, on top of which the network is trained.
    With ``base`` "spline" it is then given the spline that takes the landmarks the rest of the
    way, so that the network may be kept smoother than the landmarks alone would let it be.
    """

    name: ClassVar[str] = "siren"

    def __init__(
        self,
        dim: int,
        *,
        width: int = 128,
        depth: int = 2,
        activation: str = "sine",
        first_omega: float = 24.0,
        omega: float = 6.0,
        base: str = "spline",
        centers: int = 0,
    ) -> None:
        super().__init__()
        if base not in BASES:
            raise OptionError(f"base '{base}' is unknown: choose one of {', '.join(BASES)}")
        self.width, self.depth, self.activation = width, depth, activation
        self.first_omega, self.omega, self.base_name = first_omega, omega, base
        self.base = SplineField(dim, centers=centers)
        self.network = Network(
            [dim, *[width] * depth, dim],
            activation=activation,
            first_omega=first_omega,
            omega=omega,
        )

    def options(self) -> dict[str, Any]:
        """The arguments that rebuild this field."""
        return {
            "width": self.width,
            "depth": self.depth,
            "activation": self.activation,
            "first_omega": self.first_omega,
            "omega": self.omega,
            "base": self.base_name,
            "centers": len(self.base.centers),
        }

    def forward(self, u: Tensor) -> Tensor:
        """v: (m, dim) -> (m, dim)."""
        return self.base(u) + self.network(u)

    def jacobian(self, u: Tensor) -> Tensor:
        """∂v/∂u: (m, dim) -> (m, dim, dim)."""
        return self.base.jacobian(u) + self.network.push(Jet.seed(u, order=1)).jacobian()

    def hessian(self, u: Tensor) -> Tensor:
        """∂²v/∂u²: (m, dim) -> (m, dim, dim, dim)."""
        return self.base.hessian(u) + self.network.push(Jet.seed(u, order=2)).hessian()
