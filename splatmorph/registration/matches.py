"""Two posed surfaces brought to coincide: matches at half-time, a spline flow through them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from splatmorph.flows import Node
from splatmorph.gaussians import Gaussians
from splatmorph.registration import descriptors
from splatmorph.registration.assignment import assign, moments
from splatmorph.registration.regression import Pairs, Planes, flow, regress, still
from splatmorph.registration.subject import Subject
from splatmorph.registration.surfaces import Surface

LOOKS, SHAPES, FACINGS = 20.0, 0.01, 0.5
"""What a match costs for unlike descriptors, features and normals, against distance² / 2σ²."""
WINDOW = 0.3
"""Radii within which a match must be distinct: blank skin says nothing, a mouth says where."""
SHARP = 0.06
"""Spread within the window, in radii, at which a match counts half."""
SHRINK = 0.05
"""Power of σ / WINDOW by which the spread shrinks as σ does."""
PLAIN = 0.0095
"""Mean distinctness of matches on grey skin: where pictures tell more, the field may bend more, by
the square of the ratio. Chosen on persons 0 and 1, james → p2-1, and p2-1 and status, twisted and
swollen."""
FEW = 1300
"""Samples that are matched in the widest window."""
NEIGHBOURS = 8


@dataclass(frozen=True)
class Schedule:
    """How the search narrows, round by round; ranges go geometrically from first to last."""

    sigmas: tuple[float, ...]
    """Radii within which a partner is sought."""
    looks_anew: tuple[int, ...]
    """Rounds in which both are rendered and described as they are at half-time."""
    planes: tuple[float, float]
    """Weight of the surfaces' coming to lie on each other, against that of distinct matches."""
    bending: tuple[float, float]
    centers: tuple[int, int]
    """Of the spline field."""
    held: float = 0.1
    """Total weight of the pairs that are given."""
    trusting: float = 1.0
    """Most by which bending is made easier where pictures tell much."""
    wide: int = 0
    """Rounds in which few samples are matched in the widest window before."""

    def lasting(self, rounds: int) -> Schedule:
        """The same with so many rounds in its first window, every other one looking anew."""
        return replace(self, sigmas=self.sigmas[:1] * rounds, looks_anew=tuple(range(0, rounds, 2)))


FREE = Schedule(
    sigmas=(0.2, 0.17, 0.14, 0.12, 0.1, 0.08),
    looks_anew=(0, 2, 4),
    planes=(0.003, 0.1),
    bending=(2e-4, 2e-5),
    centers=(120, 300),
    trusting=4.0,
)
"""For two surfaces that nearly lie on each other."""
FROM_AFAR = replace(FREE, sigmas=(0.25, 0.22, *FREE.sigmas), looks_anew=(0, 2, 4, 6), wide=10)
"""For a pose that was found by search."""
WIDE = Schedule(
    sigmas=(WINDOW,),
    looks_anew=(0,),
    planes=(0.003, 0.02),
    bending=(2e-4, 5e-5),
    centers=(120, 200),
    trusting=4.0,
)
"""Before it: what a bend or a turn has taken out of sight comes into it as its neighbours move."""
HELD = replace(FREE, planes=(0.02, 0.1), bending=(6e-5, 2e-5), trusting=1.0)
"""Where landmarks are given."""
FACES = replace(HELD, planes=(0.02, 0.2))
"""Where points of faces are; their surfaces may count more. Chosen on james → p2-1 and a swollen
status, where a ``held`` of 0.01 is better still: not so between james and status."""


class Partners(NamedTuple):
    """What n samples were matched to, at half-time."""

    mean: Tensor
    """(n, 3) where a sample's partner is."""
    offset: Tensor
    """(n, 3) from the sample to it."""
    mass: Tensor
    """(n,) how much of the sample was matched, 0 to 1."""
    sure: Tensor
    """(n,) how distinct its partner is, 0 to 1."""

    def weights(self, sigma: float) -> Tensor:
        """(n,) what the matches count: less for partners far off, by Cauchy's loss."""
        return self.sure / (1 + (self.offset.norm(dim=1) / sigma).square())


@dataclass(frozen=True)
class Matched:
    """The flow from source to target, and what speaks for it."""

    node: Node
    """In the target's unit coordinates."""
    partners: tuple[Partners, ...]
    """Of the source's samples and of the target's, in the last round."""

    @property
    def distinct(self) -> float:
        """How distinct the matches were, mean of 0 to 1."""
        return _distinct(self.partners)


def match(
    source: Subject,
    target: Subject,
    schedule: Schedule,
    held: Pairs | None = None,
    on_round: Callable[[], None] | None = None,
) -> Matched:
    """Find the flow that lays ``source``, posed on ``target``, on it.

    Each round matches the samples at half-time, so that neither side is favoured; a match weighs
    by its distinctness, and less the farther it lies; then a spline field is regressed on all
    matches and on the nearest points of the other's surface.

    ``held`` are pairs in the same coordinates that are to be met beside.
    """
    state = _State(source, target, schedule, held)
    if schedule.wide:
        few = source.with_samples(FEW), target.with_samples(FEW)
        state.node = match(*few, WIDE.lasting(schedule.wide), None, on_round).node
    for number in range(len(schedule.sigmas)):
        if on_round is not None:
            on_round()
        state.advance(number, anew=number in schedule.looks_anew)
    return Matched(state.node, state.partners)


class _State:
    def __init__(
        self, source: Subject, target: Subject, schedule: Schedule, held: Pairs | None
    ) -> None:
        self.sides = source, target
        self.schedule, self.held = schedule, held
        self.a, self.b = _Cloud(source.samples), _Cloud(target.samples)
        self.dense = _Cloud(source.dense), _Cloud(target.dense)
        features = torch.cdist(
            torch.from_numpy(source.samples.features), torch.from_numpy(target.samples.features)
        )
        self.fixed = SHAPES * features.square()
        self.fixed += FACINGS * (1 - self.a.normals @ self.b.normals.T)
        self.looks = self.fixed
        self.node = still()
        self.partners: tuple[Partners, ...] = ()
        if held is not None:
            centers = min(len(held.p), schedule.centers[1])
            self.node = regress(
                self.node, held, bending=schedule.bending[0], centers=centers, corrections=5
            )

    def advance(self, number: int, *, anew: bool) -> None:
        """One round: match, then fit; ``anew``: both are looked at as they are at half-time."""
        schedule, a, b = self.schedule, self.a, self.b
        done = number / max(1, len(schedule.sigmas) - 1)
        sigma = schedule.sigmas[number]
        here, there = flow(self.node, a.points, 0.5), flow(self.node, b.points, -0.5)
        if anew:
            self.looks = self.fixed + LOOKS * self._compare(here, there)
        self.partners = ahead, back = self._matches(here, there, sigma)
        trust = max(1.0, min(schedule.trusting, (_distinct(self.partners) / PLAIN) ** 2)) ** done
        count = len(a) + len(b)
        pairs = Pairs(
            torch.cat([a.points, flow(self.node, back.mean, -0.5)]),
            torch.cat([flow(self.node, ahead.mean, 0.5), b.points]),
            torch.cat([side.weights(sigma) for side in self.partners]) / count,
        )
        if self.held is not None:
            share = self.held.weights * (schedule.held / self.held.weights.sum())
            pairs = Pairs.join(pairs, replace(self.held, weights=share))
        self.node = regress(
            self.node,
            pairs,
            self._planes(max(sigma, 0.1), _between(schedule.planes, done) / count),
            bending=_between(schedule.bending, done) / trust,
            centers=int(_between(schedule.centers, done)),
        )

    def _matches(self, here: Tensor, there: Tensor, sigma: float) -> tuple[Partners, ...]:
        """The partners of the source's samples and of the target's, as both lie at half-time."""
        apart = torch.cdist(here, there).square()
        plan = assign(apart / (2 * sigma**2) + self.looks)
        wide = plan if sigma >= WINDOW else assign(apart / (2 * WINDOW**2) + self.looks)
        shrink = (min(sigma, WINDOW) / WINDOW) ** SHRINK
        found = []
        for own, other, given, window in (
            (here, there, plan, wide),
            (there, here, plan.T, wide.T),
        ):
            mass, mean, _ = moments(given, other)
            spread = moments(window, other)[2] * shrink
            sure = mass.clamp(0, 1) * SHARP**2 / (spread + SHARP**2)
            found.append(Partners(mean, mean - own, mass, sure))
        return tuple(found)

    def _compare(self, here: Tensor, there: Tensor) -> Tensor:
        """Descriptor distances (n, m) of the samples as both look at half-time."""
        middle = ((here.mean(0) + there.mean(0)) / 2).double().numpy()
        cameras = descriptors.cameras_of(middle)
        seen, other = (
            descriptors.describe(
                moved(side.gaussians, self.node, t),
                points.double().numpy(),
                side.samples.normals,
                cameras,
            )
            for side, points, t in zip(self.sides, (here, there), (0.5, -0.5), strict=True)
        )
        return descriptors.distances(seen, other, (len(here), len(there)))[0]

    def _planes(self, reach: float, weight: float) -> Planes:
        """Each sample and the nearest point at half-time of the other surface that faces the same
        way, both directions; beyond ``reach`` they fade out."""
        found = []
        for own, other, t in ((self.a, self.dense[1], 0.5), (self.b, self.dense[0], -0.5)):
            here, there = flow(self.node, own.points, t), flow(self.node, other.points, -t)
            distance, index = cKDTree(there.numpy()).query(here.numpy(), NEIGHBOURS)
            near, which = torch.from_numpy(distance).float(), torch.from_numpy(index)
            alike = (own.normals[:, None] * other.normals[which]).sum(2)
            best = (near + reach * (1 - alike)).argmin(1, keepdim=True)
            which = which.gather(1, best)[:, 0]
            normals = own.normals + other.normals[which]
            normals = normals / (normals.norm(dim=1, keepdim=True) + 1e-6)
            offset = there[which] - here
            height = (offset * normals).sum(1, keepdim=True)
            fade = 1 + (offset.norm(dim=1) / reach).square()
            alike = alike.gather(1, best)[:, 0].clamp_min(0)
            onto = flow(self.node, here + height * normals, t)
            ends = (own.points, onto) if t > 0 else (onto, own.points)
            found.append((*ends, weight * (alike / fade).square(), normals))
        return Planes(*(torch.cat(part) for part in zip(*found, strict=True)))


class _Cloud:
    """A surface's points and normals, float32."""

    def __init__(self, surface: Surface) -> None:
        self.points = torch.from_numpy(surface.points).float()
        self.normals = torch.from_numpy(surface.normals).float()

    def __len__(self) -> int:
        return len(self.points)


def moved(gaussians: Gaussians, node: Node, t: float) -> Gaussians:
    """The splats where the flow takes their centers; shapes stay."""
    return replace(gaussians, means=flow(node, gaussians.means, t))


def _distinct(partners: tuple[Partners, ...]) -> float:
    return float(torch.cat([side.sure for side in partners]).mean())


def _between(ends: tuple[float, float], done: float) -> float:
    return ends[0] * (ends[1] / ends[0]) ** done
