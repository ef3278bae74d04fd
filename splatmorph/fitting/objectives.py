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

STICKS = 2000
"""Short sticks that the spline carries along, for an NCF to follow."""
STICK = 0.1
"""Their length in frame units."""
BEYOND = 0.15
"""How far beyond the box they lie, as a part of its sides: couplings reach everywhere, and what
none asks for out there can be anything."""
SLOPES = 0.1
"""How much the square of a difference per length weighs against that of a place."""
MET = 1e-7
"""Mean squared gap of a landmark below which little is gained by meeting it closer."""


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

    def sample(self, count: int, generator: torch.Generator, beyond: float = 0.0) -> Tensor:
        """(count, dim) points; half of them from the object where there is one.

        ``beyond``: by what part of its sides the box is made larger at every face.
        """
        noise = (1 + 2 * beyond) * torch.rand(count, len(self.low), generator=generator) - beyond
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
    """NCF: the landmarks at both ends, and the spline's flow everywhere else.

    The spline is the field of least second-order energy that meets the landmarks, and is solved
    for. Where it takes the two ends of a short stick, there the NCF is asked to take them too: the
    ends' mean and, in proportion to its length, their difference, which is a derivative. That needs
    no derivatives of H, and what it lacks of the least energy is what it differs by.

    A conjugate flow has one fixed point at most, the spline any number, so that the one cannot
    always follow the other. The two errors are weighed by their logarithms: each step is worth the
    part of either that it takes off, whatever their sizes.
    """

    def __init__(
        self, flow: Conjugate, p: Tensor, q: Tensor, region: Region, config: FitConfig
    ) -> None:
        self.module = flow
        self.p, self.q = p.float(), q.float()
        self.recipe = Recipe(800, 4e-3, 150, 1.0, 0.05)
        spline = SplineField(flow.dim)
        settings = FitConfig(smoothing=config.smoothing)
        solve_spline(spline, p, q, settings, lambda *_: None)
        generator = torch.Generator().manual_seed(config.seed)
        middle = region.sample(STICKS, generator, BEYOND)
        along = STICK / 2 * directions(1, len(middle), flow.dim, generator)[0].to(middle)
        sticks = torch.cat([middle - along, middle + along]).to(p)
        half = torch.full_like(sticks[:, :1], 0.5)
        self.starts, self.ends = (
            runge_kutta(spline, sticks, time, FINE_STEPS // 2).float().unflatten(0, (2, -1))
            for time in (-half, half)
        )

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
        """Logarithm of the landmarks' error plus ``weight`` times that of the sticks'."""
        chosen = torch.randint(self.starts.shape[1], (self.recipe.samples,), generator=generator)
        starts, ends = (
            points[:, chosen.to(points.device)].flatten(0, 1) for points in (self.starts, self.ends)
        )
        gaps = self._gaps(torch.cat([self.p, starts]), torch.cat([self.q, ends]))
        landmarks = torch.log(gaps[:, : len(self.p)].square().sum(2).mean() + MET)
        if weight == 0:
            return landmarks
        one, other = gaps[:, len(self.p) :].unflatten(1, (2, -1)).unbind(1)
        place = ((one + other) / 2).square().sum(2).mean()
        slope = ((one - other) / STICK).square().sum(2).mean()
        return landmarks + weight * torch.log(place + SLOPES * self.module.dim * slope)

    def mse(self) -> float:
        """Mean squared gap a coordinate at both ends."""
        return float(self._gaps(self.p, self.q).square().mean())

    def finish(self) -> None:
        """Nothing is left to do."""

    def _gaps(self, p: Tensor, q: Tensor) -> Tensor:
        """Φ(p, 1) - q and Φ(q, -1) - p: (2, k, dim)."""
        ends = torch.stack([p, q])
        linear, shift = self.module.affine_flow(p.new_tensor([1.0, -1.0]))
        z = self.module.straighten(ends.flatten(0, 1)).view_as(ends)
        # Not a matrix product: for so few columns that takes longer to wake threads.
        z = (z[:, :, None] * linear[:, None]).sum(-1) + shift[:, None]
        return self.module.bend(z.flatten(0, 1)).view_as(ends) - ends.flip(0)


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
