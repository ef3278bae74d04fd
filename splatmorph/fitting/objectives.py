"""What each trained flow minimises (paper, eq. 3)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from splatmorph.fitting.report import FitConfig
from splatmorph.fitting.solve import affine_velocity, half_time_gap, solve_spline
from splatmorph.fitting.train import Recipe
from splatmorph.flows.conjugate import Conjugate
from splatmorph.flows.ifmorph import Ifmorph
from splatmorph.flows.jets import Jet
from splatmorph.flows.node import Node, runge_kutta
from splatmorph.flows.siren import SirenField
from splatmorph.flows.spline import SplineField
from splatmorph.metrics import padded_box

FINE_STEPS = 8
"""Runge-Kutta steps to t = 1/2 when the true metric is taken."""


SIREN_RECIPES = {
    ("spline", "hessian"): Recipe(150, 1e-2, 500, 1e-3, 1e-4),
    ("spline", "jacobian"): Recipe(150, 1e-2, 500, 1e-3, 1e-5),
    ("affine", "hessian"): Recipe(400, 1e-2, 500, 1e-4, 1e-7),
    ("affine", "jacobian"): Recipe(400, 1e-2, 500, 1e-3, 1e-6),
}
"""By base and energy: with a spline to finish on, the network need not meet the landmarks."""


class Region:
    """Where the energy is sampled: the landmarks' padded box and, where given, the object."""

    def __init__(self, points: Tensor, domain: Tensor | None) -> None:
        self.low, high = padded_box(points)
        self.sides = high - self.low
        self.domain = domain

    def sample(self, count: int, generator: torch.Generator) -> Tensor:
        """(count, dim) points; half of them from the object where there is one."""
        noise = torch.rand(count, len(self.low), generator=generator)
        box = self.low + noise.to(self.low) * self.sides
        if self.domain is None:
            return box
        chosen = torch.randint(len(self.domain), (count // 2,), generator=generator)
        return torch.cat([box[count // 2 :], self.domain[chosen.to(self.domain.device)]])


class SirenObjective:
    """NODE with a SIREN field: half-time gap, and the Jacobian or Hessian energy of the field.

    The energy is sampled without bias along random directions: one unit vector e for
    dim · |∂v e|², two for dim² · |∂²v(e, f)|².
    """

    def __init__(self, flow: Node, p: Tensor, q: Tensor, region: Region, config: FitConfig) -> None:
        assert isinstance(flow.field, SirenField)
        self.module = flow
        self.field = flow.field
        self.ends = p, q
        self.p, self.q = p.float(), q.float()
        self.region = region
        self.config = config
        self.energy = "jacobian" if config.energy == "jacobian" else "hessian"
        self.recipe = SIREN_RECIPES[self.field.base_name, self.energy]

    def initialise(self, seed: int) -> list[nn.Parameter]:
        """Draw the network anew, on the affine base."""
        nowhere = self.ends[0][:0]
        self.field.base.set(nowhere, nowhere, affine_velocity(*self.ends))
        self.field.network.initialise(torch.Generator().manual_seed(seed))
        return list(self.field.network.parameters())

    def loss(self, weight: float, generator: torch.Generator) -> Tensor:
        """Mean squared gap plus ``weight`` times the energy."""
        gap = half_time_gap(self.field, self.p, self.q).square().sum(1).mean()
        x = self.region.sample(self.recipe.samples, generator)
        return gap + weight * self._energy(x, generator)

    def _energy(self, x: Tensor, generator: torch.Generator) -> Tensor:
        count, dim = x.shape
        if self.energy == "jacobian":
            e = directions(1, count, dim, generator).to(x)
            slope = self.field.network.push(Jet(x, e)).first[0]
            slope = slope + (self.field.base.jacobian(x) @ e[0][..., None])[..., 0]
            return dim * slope.square().sum(1).mean()
        e = directions(2, count, dim, generator).to(x)
        bend = self.field.network.push(Jet(x, e, ((0, 1),))).second
        assert bend is not None
        return dim**2 * bend[0].square().sum(1).mean()

    def mse(self) -> float:
        """Mean squared gap a coordinate, finely integrated."""
        return fine_mse(self.field, self.p, self.q)

    def finish(self) -> None:
        """Let the spline, where it is the base, take the landmarks the rest of the way."""
        if self.field.base_name == "affine":
            return
        base, network = self.field.base, self.field.network
        start = SplineField(self.module.dim)
        start.set(base.centers[:0], base.weights[:0], base.affine)

        def velocity(u: Tensor) -> Tensor:
            return start(u) + network(u) + base(u)

        settings = FitConfig(smoothing=self.config.smoothing, tolerance=self.config.tolerance)
        solve_spline(base, *self.ends, settings, lambda *_: None, velocity)
        base.affine += start.affine


class ConjugateObjective:
    """NCF: the gap at t = 1/2, which an exact flow keeps at all t, and the energy of eq. 3."""

    def __init__(self, flow: Conjugate, p: Tensor, q: Tensor, region: Region) -> None:
        self.module = flow
        self.p, self.q = p.float(), q.float()
        self.region = region
        # In the plane one coordinate alone steers the other, and more energy is needed to keep
        # H from wrinkling beyond the landmarks.
        weights = (1e-2, 3e-4) if flow.dim == 2 else (1e-3, 3e-6)
        self.recipe = Recipe(600, 1e-2, 150, *weights)

    def initialise(self, seed: int) -> list[nn.Parameter]:
        """Couplings near the identity, under the least-squares affine velocity."""
        generator = torch.Generator().manual_seed(seed)
        self.module.initialise(generator)
        affine = affine_velocity(self.p, self.q)
        with torch.no_grad():
            self.module.drift.copy_(affine[0])
            self.module.generator.copy_(affine[1:].T)
        return list(self.module.parameters())

    def loss(self, weight: float, generator: torch.Generator) -> Tensor:
        """Mean squared gap plus ``weight`` times the Jacobian energy of the velocity."""
        x = self.region.sample(self.recipe.samples, generator)
        e = directions(1, len(x), x.shape[1], generator).to(x)
        slope = self.module.velocity_slopes(x, e)[0]
        return self._gap().square().sum(1).mean() + weight * x.shape[1] * (
            slope.square().sum(1).mean()
        )

    def mse(self) -> float:
        """Mean squared gap a coordinate."""
        return float(self._gap().square().mean())

    def finish(self) -> None:
        """Nothing is left to do."""

    def _gap(self) -> Tensor:
        half = self.p.new_full((len(self.p),), 0.5)
        ends = self.module.unit_forward(torch.cat([self.p, self.q]), torch.cat([half, -half]))
        return ends[len(self.p) :] - ends[: len(self.p)]


class IfmorphObjective:
    """ifmorph's penalties (Schardong 2024): data, identity, inverse and a Hessian in (x, t).

    The weights are the public ones for a mean over all points; it is no flow, so the landmarks
    are matched at several times.
    """

    TIMES = (0.25, 0.5, 0.75)

    def __init__(self, flow: Ifmorph, p: Tensor, q: Tensor, region: Region) -> None:
        self.module = flow
        self.p, self.q = p.float(), q.float()
        self.region = region
        self.recipe = Recipe(2000, 1e-3, 300, 1e-3, 1e-3)

    def initialise(self, seed: int) -> list[nn.Parameter]:
        """Draw the network anew."""
        self.module.network.initialise(torch.Generator().manual_seed(seed))
        return list(self.module.parameters())

    def loss(self, weight: float, generator: torch.Generator) -> Tensor:
        """Landmark, identity and inverse terms plus ``weight`` times the Hessian."""
        x = self.region.sample(self.recipe.samples, generator)
        t = torch.rand(len(x), generator=generator).to(x) * 2 - 1
        identity = self.module.unit_forward(x, 0.0) - x
        inverse = self.module.unit_forward(self.module.unit_forward(x, t), -t) - x
        # Public ratios: data and inverse 10⁴, identity and thin plate 10³.
        terms = self._landmarks() + 0.1 * identity.square().mean() + inverse.square().mean()
        return terms + 100 * weight * self._bending(x, t, generator)

    def _landmarks(self) -> Tensor:
        phi, p, q = self.module.unit_forward, self.p, self.q
        total = 100 * ((phi(p, 1.0) - q).square().mean() + (phi(q, -1.0) - p).square().mean())
        for t in self.TIMES:
            forward, backward = phi(p, t), phi(q, t - 1)
            total = total + 50 * (forward - backward).square().mean()
            total = total + 20 * (phi(forward, -t) - p).square().mean()
            total = total + 20 * (phi(backward, 1 - t) - q).square().mean()
        return total

    def _bending(self, x: Tensor, t: Tensor, generator: torch.Generator) -> Tensor:
        joint = torch.cat([x, t[:, None]], dim=1)
        e = directions(2, len(x), joint.shape[1], generator).to(x)
        bend = self.module.network.push(Jet(joint, e, ((0, 1),))).second
        assert bend is not None
        return joint.shape[1] ** 2 * bend[0].square().mean()

    def mse(self) -> float:
        """Mean over times of the squared gap a coordinate."""
        phi = self.module.unit_forward
        gaps = [phi(self.p, t) - phi(self.q, t - 1) for t in (0.0, *self.TIMES, 1.0)]
        return float(torch.stack(gaps).square().mean())

    def finish(self) -> None:
        """Nothing is left to do."""


def fine_mse(field: nn.Module, p: Tensor, q: Tensor) -> float:
    """Mean squared half-time gap a coordinate, in steps far below those of training."""
    half = p.new_full((len(p), 1), 0.5)
    ends = runge_kutta(field, torch.cat([p, q]), torch.cat([half, -half]), FINE_STEPS)
    return float((ends[len(p) :] - ends[: len(p)]).square().mean())


def directions(many: int, count: int, dim: int, generator: torch.Generator) -> Tensor:
    """(many, count, dim) random unit vectors."""
    return nn.functional.normalize(torch.randn(many, count, dim, generator=generator), dim=-1)
