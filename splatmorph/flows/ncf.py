"""NCF: the neural conjugate flow, an affine flow seen through a bijection of space."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from splatmorph.flows.base import Flow
from splatmorph.flows.jets import Activation, Jet
from splatmorph.flows.native import jet as native
from splatmorph.flows.network import Network

LARGEST_LOG_SCALE = 0.3
"""Bound on the logarithm of what one coupling stretches by: keeps the inverse well conditioned,
and a training from running away."""


class Coupling(nn.Module):
    """z_i ← exp(s(z_rest)) · z_i + h(z_rest) for one coordinate i: a bijection of R^dim.

    s = bound · tanh of the network's first output, h its second. Unlike an additive coupling it
    changes volume, without which a conjugate flow has one determinant everywhere.
    """

    def __init__(self, dim: int, moved: int, width: int, **network: Any) -> None:
        super().__init__()
        self.moved = moved
        self.kept = [i for i in range(dim) if i != moved]
        order = [*self.kept, moved]
        self.back = [order.index(i) for i in range(dim)]
        self.network = Network([dim - 1, width, width, 2], **network)

    def push(self, jet: Jet) -> Jet:
        """The coupling, with derivatives."""
        log_scale, shift = self._jets(jet, 1.0)
        return self._join(jet, jet.columns([self.moved]) * log_scale.activate(_exp) + shift)

    def push_inverse(self, jet: Jet) -> Jet:
        """Its inverse, with derivatives."""
        log_scale, shift = self._jets(jet, -1.0)
        difference = jet.columns([self.moved]) + shift.activate(_negative)
        return self._join(jet, difference * log_scale.activate(_exp))

    def _jets(self, jet: Jet, sign: float) -> tuple[Jet, Jet]:
        raw = self.network.push(jet.columns(self.kept))
        return raw.columns([0]).activate(_bounded(sign)), raw.columns([1])

    def _join(self, jet: Jet, moved: Jet) -> Jet:
        return Jet.join(jet.columns(self.kept), moved).columns(self.back)


class NCF(Flow):
    """Φ(x, t) = H⁻¹(Ψ(H(x), t)), Ψ(z, t) = e^{At} z + ∫₀ᵗ e^{Aτ} b dτ (paper, eq. 5).

    H is a chain of ``layers`` affine couplings, so that it is a bijection of R^dim itself and Φ
    obeys the laws of a flow to rounding. They move one coordinate after the other, and after every
    round of dim the axes are turned: in the plane a coupling shears along one line, and only lines
    in many directions make up a warp. The matrix exponential is taken once for each distinct t.
    """

    kind = "ncf"
    turns: Tensor

    def __init__(
        self,
        dim: int,
        *,
        layers: int = 24,
        width: int = 32,
        activation: str = "sine",
        first_omega: float = 10.0,
        omega: float = 4.0,
    ) -> None:
        super().__init__(dim)
        self.options = {
            "layers": layers,
            "width": width,
            "activation": activation,
            "first_omega": first_omega,
            "omega": omega,
        }
        self.generator = nn.Parameter(torch.zeros(dim, dim))
        self.drift = nn.Parameter(torch.zeros(dim))
        self.chain = tuple(
            Coupling(
                dim,
                layer % dim,
                width,
                activation=activation,
                first_omega=first_omega,
                omega=omega,
            )
            for layer in range(layers)
        )
        self.couplings = nn.ModuleList(self.chain)
        self.register_buffer("turns", _turns(dim, -(-layers // dim)))

    def config(self) -> dict[str, Any]:
        """Kind, dimension and the network's options."""
        return {**super().config(), **self.options}

    def straighten(self, u: Tensor) -> Tensor:
        """H: (m, dim) frame points -> (m, dim), where the flow is affine."""
        return self._push(Jet(u, u.new_empty(0, *u.shape))).value

    def bend(self, z: Tensor) -> Tensor:
        """H⁻¹."""
        return self._push_inverse(Jet(z, z.new_empty(0, *z.shape))).value

    def affine_flow(self, times: Tensor) -> tuple[Tensor, Tensor]:
        """e^{At} and ∫₀ᵗ e^{Aτ} b dτ for times (T,): (T, dim, dim) and (T, dim)."""
        dim = self.dim
        augmented = times.new_zeros(dim + 1, dim + 1)
        augmented[:dim, :dim] = self.generator.to(times)
        augmented[:dim, dim] = self.drift.to(times)
        exponential = torch.linalg.matrix_exp(times[:, None, None] * augmented)
        return exponential[:, :dim, :dim], exponential[:, :dim, dim]

    def initialise(self, generator: torch.Generator) -> None:
        """Draw the couplings anew, near the identity."""
        for coupling in self.chain:
            coupling.network.initialise(generator)

    def unit_velocity(self, u: Tensor) -> Tensor:
        """v(u) in the frame: (∂H⁻¹)(z) · (A z + b) at z = H(u)."""
        z = self.straighten(u)
        return self._push_inverse(Jet(z, self._affine_rate(z)[None])).first[0]

    def unit_velocity_jacobian(self, u: Tensor) -> Tensor:
        """∂v/∂u in the frame."""
        basis = torch.eye(self.dim).to(u)[:, None].expand(self.dim, len(u), self.dim)
        return self.velocity_slopes(u, basis).permute(1, 2, 0)

    def velocity_slopes(self, u: Tensor, directions: Tensor) -> Tensor:
        """∂v/∂u · e for directions e (d, m, dim): -> (d, m, dim).

        v is the image of w = A z + b under ∂H⁻¹, so its derivative along e is the second
        derivative of H⁻¹ along w and ∂H e, where w itself changes by A ∂H e.
        """
        count = len(directions)
        straight = self._push(Jet(u, directions))
        rate = self._affine_rate(straight.value)
        along = torch.cat([straight.first, rate[None]])
        pairs = tuple((i, count) for i in range(count))
        changing = straight.first @ self.generator.to(u).T
        slopes = self._push_inverse(Jet(straight.value, along, pairs, changing)).second
        assert slopes is not None
        return slopes

    def unit_forward(self, u: Tensor, t: float | Tensor) -> Tensor:
        """Φ(u, t) in the frame."""
        times = torch.as_tensor(t, dtype=u.dtype, device=u.device).reshape(-1)
        distinct, which = torch.unique(times, return_inverse=True)
        linear, shift = self.affine_flow(distinct)
        z = self.straighten(u)
        if len(distinct) == 1:
            return self.bend(z @ linear[0].T + shift[0])
        return self.bend((linear[which] @ z[..., None])[..., 0] + shift[which])

    def unit_trajectory(
        self, u: Tensor, times: list[float], *, jacobian: bool
    ) -> tuple[Tensor, Tensor | None]:
        """Φ(u, t) for every t and, where asked, ∂Φ/∂u by the chain rule."""
        linear, shift = self.affine_flow(u.new_tensor(times))
        if not jacobian:
            z = self.straighten(u)
            moved = [self.bend(z @ e.T + c) for e, c in zip(linear, shift, strict=True)]
            return torch.stack(moved) if moved else u.new_empty(0, *u.shape), None
        start = self._push(Jet.seed(u, order=1))
        jets = [self._push_inverse(start.linear(e, c)) for e, c in zip(linear, shift, strict=True)]
        return (
            torch.stack([jet.value for jet in jets]),
            torch.stack([jet.jacobian() for jet in jets]),
        )

    def unit_hessian(self, u: Tensor, t: float) -> Tensor:
        """∂²Φ/∂u²(u, t) in the frame, (m, dim, dim, dim): the Hessian of the paper's app. A."""
        linear, shift = self.affine_flow(u.new_tensor([t]))
        straight = self._push(Jet.seed(u, order=2))
        return self._push_inverse(straight.linear(linear[0], shift[0])).hessian()

    def _push(self, jet: Jet) -> Jet:
        turns = self.turns.to(jet.value)
        before = dict(zip(range(0, len(self.chain), self.dim), turns, strict=False))
        steps = [(coupling, before.get(i)) for i, coupling in enumerate(self.chain)]
        return self._through(jet, steps, LARGEST_LOG_SCALE).linear(turns[-1])

    def _push_inverse(self, jet: Jet) -> Jet:
        turns = self.turns.to(jet.value).mT.contiguous()
        ends = [*range(self.dim, len(self.chain), self.dim), len(self.chain)]
        after = dict(zip(ends, turns[1:], strict=True))
        steps = [(coupling, after.get(i)) for i, coupling in enumerate(self.chain, 1)]
        return self._through(jet, steps[::-1], -LARGEST_LOG_SCALE).linear(turns[0])

    def _through(self, jet: Jet, steps: list[tuple[Coupling, Tensor | None]], bound: float) -> Jet:
        """``jet`` turned and pushed through each coupling, or with a negative bound its inverse."""
        if native.takes("coupling", jet, self.chain[0].network.layers()):
            return native.push_couplings(
                jet,
                [native.Step(one.network.layers(), one.moved, bound, turn) for one, turn in steps],
            )
        for coupling, turn in steps:
            if turn is not None:
                jet = jet.linear(turn)
            jet = coupling.push(jet) if bound > 0 else coupling.push_inverse(jet)
        return jet

    def _affine_rate(self, z: Tensor) -> Tensor:
        return z @ self.generator.to(z).T + self.drift.to(z)


def _turns(dim: int, rounds: int) -> Tensor:
    # From the axes of the frame to those of the first round, from these to the next, and back.
    generator = torch.Generator().manual_seed(0)
    drawn = torch.randn(rounds, dim, dim, generator=generator, dtype=torch.float64)
    whole = torch.eye(dim, dtype=torch.float64)[None]
    axes = torch.cat([whole, torch.linalg.qr(drawn).Q, whole])
    return axes[1:] @ axes[:-1].mT


def _exp(z: Tensor, order: int) -> tuple[Tensor, ...]:
    g = torch.exp(z)
    return (g, g, g)[: order + 1]


def _negative(z: Tensor, order: int) -> tuple[Tensor, ...]:
    return (-z, torch.full_like(z, -1), torch.zeros_like(z))[: order + 1]


def _bounded(sign: float) -> Activation:
    def derivatives(z: Tensor, order: int) -> tuple[Tensor, ...]:
        bound = sign * LARGEST_LOG_SCALE
        g = torch.tanh(z)
        slope = 1 - g * g
        return (bound * g, bound * slope, -2 * bound * g * slope)[: order + 1]

    return derivatives
