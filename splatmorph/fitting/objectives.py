"""What each trained flow minimises (paper, eq. 3)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from splatmorph.errors import FitError
from splatmorph.fitting.report import FitConfig
from splatmorph.fitting.solve import affine_velocity, half_time_gap, solve_spline
from splatmorph.fitting.task import Task
from splatmorph.fitting.train import Recipe
from splatmorph.flows.base import Flow
from splatmorph.flows.ifmorph import Ifmorph
from splatmorph.flows.jets import Jet
from splatmorph.flows.ncf import NCF
from splatmorph.flows.node import Node, runge_kutta
from splatmorph.flows.siren import SirenField
from splatmorph.flows.spline import SplineField

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
DIFFERENCE = 2e-2
"""Frame units between points whose velocities are subtracted: in single precision it leaves four
digits of a first derivative and two of a second."""
TOO_STEEP = 30.0
"""Times the spline's first-order energy that a conjugate flow of the plane may have: its slopes
are then some five times as steep as they need be, on average."""
LEAST_STEEP = 1e-4
"""First-order energy that counts as none."""
MET = 1e-7
"""Mean squared gap of a landmark below which little is gained by meeting it closer."""


SIREN_RECIPES = {
    ("spline", "hessian"): Recipe(150, 1e-2, 500, 1e-3, 1e-4),
    ("spline", "jacobian"): Recipe(150, 1e-2, 500, 1e-3, 1e-5),
    ("affine", "hessian"): Recipe(400, 1e-2, 500, 1e-4, 1e-7),
    ("affine", "jacobian"): Recipe(400, 1e-2, 500, 1e-3, 1e-6),
}
"""By base and energy: with a spline to finish on, the network need not meet the landmarks."""


class PaperObjective:
    """Any flow that can be differentiated in its weights: the paper's eq. 3, at half-time.

    |Φ(p, 1/2) - Φ(q, -1/2)|² + w · E_x |∂v/∂x|², or the Hessian energy where that is asked for.
    The derivatives of the velocity are central differences along random directions, as the SIREN's
    are, so that a flow need give none.
    """

    TIMES = (0.0, 0.5, 1.0)

    def __init__(self, flow: Flow, task: Task) -> None:
        self.module = flow
        self.parameters = list(flow.parameters())
        if not self.parameters:
            raise FitError(
                f"flow '{flow.kind}' has no weights to train: tell splatmorph.fitting another way "
                "to fit it, by fitted_by"
            )
        self.drawn = {name: value.clone() for name, value in flow.state_dict().items()}
        self.p, self.q = task.p.float(), task.q.float()
        self.region = task.region
        self.energy = "hessian" if task.config.energy == "hessian" else "jacobian"
        self.recipe = Recipe(1000, 5e-3, 500, 1e-3, 1e-5)

    def initialise(self, seed: int) -> list[nn.Parameter]:
        """As it came, with those weights drawn anew that are drawn."""
        self.module.load_state_dict(self.drawn)
        self.module.initialise(torch.Generator().manual_seed(seed))
        return self.parameters

    def loss(self, weight: float, generator: torch.Generator) -> Tensor:
        """Mean squared gap plus ``weight`` times the energy."""
        gap = self._gap(0.5).square().sum(1).mean()
        if not gap.requires_grad:
            raise FitError(
                f"flow '{self.module.kind}' can't be differentiated in its weights: train it "
                "without torch.no_grad, or tell splatmorph.fitting another way by fitted_by"
            )
        if weight == 0:
            return gap
        x = self.region.sample(self.recipe.samples, generator)
        return gap + weight * self._energy(x, generator)

    def _gap(self, t: float) -> Tensor:
        return self.module.unit_forward(self.p, t) - self.module.unit_forward(self.q, t - 1)

    def _energy(self, x: Tensor, generator: torch.Generator) -> Tensor:
        count, dim = x.shape
        many = 1 if self.energy == "jacobian" else 2
        steps = DIFFERENCE * directions(many, count, dim, generator).to(x)
        signs = torch.cartesian_prod(*[x.new_tensor([1.0, -1.0])] * many).reshape(-1, many)
        moved = x + (signs[:, :, None, None] * steps).sum(1)
        speeds = self.module.unit_velocity(moved.flatten(0, 1)).unflatten(0, (-1, count))
        slope = (signs.prod(1)[:, None, None] * speeds).sum(0) / (2 * DIFFERENCE) ** many
        return dim**many * slope.square().sum(1).mean()

    def mse(self) -> float:
        """Mean over times of the squared gap a coordinate."""
        return float(torch.stack([self._gap(t) for t in self.TIMES]).square().mean())

    def finish(self) -> None:
        """Nothing is left to do."""


class SirenObjective:
    """NODE with a SIREN field: half-time gap, and the Jacobian or Hessian energy of the field.

    The energy is sampled without bias along random directions: one unit vector e for
    dim · |∂v e|², two for dim² · |∂²v(e, f)|².
    """

    def __init__(self, flow: Node, task: Task) -> None:
        assert isinstance(flow.field, SirenField)
        self.module = flow
        self.field = flow.field
        self.ends = task.p, task.q
        self.p, self.q = task.p.float(), task.q.float()
        self.region = task.region
        self.config = task.config
        self.energy = "jacobian" if task.config.energy == "jacobian" else "hessian"
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

        settings = FitConfig(
            smoothing=self.config.bending,
            shear=self.config.shear,
            tolerance=self.config.tolerance,
        )
        solve_spline(base, *self.ends, settings, lambda *_: None, velocity)
        base.affine += start.affine


class NCFObjective:
    """NCF: the landmarks at both ends, and the spline's flow everywhere else.

    The spline is the field of least second-order energy that meets the landmarks, and is solved
    for. Where it takes the two ends of a short stick, there the NCF is asked to take them too: the
    ends' mean and, in proportion to its length, their difference, which is a derivative. That needs
    no derivatives of H, and what it lacks of the least energy is what it differs by.

    A conjugate flow has one fixed point at most, the spline any number, so that the one cannot
    always follow the other. The two errors are weighed by their logarithms: each step is worth the
    part of either that it takes off, whatever their sizes.

    In the plane, where the spline between two faces has several fixed points, the sticks weigh more
    and their velocities are asked for too: what comes to the right places may else have gone there
    in a whirl. What is still ``TOO_STEEP`` is refused.
    """

    def __init__(self, flow: NCF, task: Task) -> None:
        p, q, config = task.p, task.q, task.config
        self.module = flow
        self.p, self.q = p.float(), q.float()
        plane = flow.dim == 2
        self.recipe = Recipe(800, 4e-3, 150, 1.0, 0.5 if plane else 0.05)
        spline = self.spline = SplineField(flow.dim)
        settings = FitConfig(smoothing=config.bending, shear=config.shear)
        solve_spline(spline, p, q, settings, lambda *_: None)
        generator = torch.Generator().manual_seed(config.seed)
        middle = task.region.sample(STICKS, generator, BEYOND)
        along = STICK / 2 * directions(1, len(middle), flow.dim, generator)[0].to(middle)
        sticks = torch.cat([middle - along, middle + along]).to(p)
        half = torch.full_like(sticks[:, :1], 0.5)
        self.starts, self.ends = (
            runge_kutta(spline, sticks, time, FINE_STEPS // 2).float().unflatten(0, (2, -1))
            for time in (-half, half)
        )
        self.rates = spline(self.starts.double().flatten(0, 1)).float().unflatten(0, (2, -1))
        self.follows = plane

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
        if self.follows:
            missed = self.module.unit_velocity(starts).unflatten(0, (2, -1)) - self.rates[:, chosen]
            place = place + missed.mean(0).square().sum(1).mean()
            slope = slope + ((missed[0] - missed[1]) / STICK).square().sum(1).mean()
        return landmarks + weight * torch.log(place + SLOPES * self.module.dim * slope)

    def mse(self) -> float:
        """Mean squared gap a coordinate at both ends."""
        return float(self._gaps(self.p, self.q).square().mean())

    def finish(self) -> None:
        """Refuse a field that is steeper than it need be.

        Raises:
            FitError: says by how much.
        """
        if not self.follows:
            return
        middles = self.starts.mean(0)
        own = self.module.unit_velocity_jacobian(middles).square().sum((1, 2)).mean()
        least = self.spline.jacobian(middles.double()).square().sum((1, 2)).mean()
        times = float(own / least.clamp(min=LEAST_STEEP))
        if times > TOO_STEEP:
            raise FitError(
                f"no calm conjugate flow was found between these landmarks: its energy is "
                f"{times:.0f} times the least that meets them, expected at most "
                f"{TOO_STEEP:.0f}; take the node flow, whose field may rest at several points"
            )

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

    def __init__(self, flow: Ifmorph, task: Task) -> None:
        self.module = flow
        self.p, self.q = task.p.float(), task.q.float()
        self.region = task.region
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
