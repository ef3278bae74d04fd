"""Morph: two splats and a flow, and the splats in between."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property, partial
from itertools import groupby
from typing import NamedTuple, Protocol, TypeVar

import torch
from torch import Tensor

from splatmorph.errors import NonFiniteError, OptionError
from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.similarity import Similarity
from splatmorph.morph.agreement import Agreement, OnStep, agree
from splatmorph.morph.memory import Memory
from splatmorph.morph.paths import Drift
from splatmorph.morph.ramps import DEFAULT_RAMP, EASES, RAMPS
from splatmorph.morph.splitting import split_stretched
from splatmorph.morph.transport import COVARIANCES, DEFAULT_COVARIANCE, colour_turns
from splatmorph.steady import one_thread

Choice = TypeVar("Choice")

BLENDS = {"agree": True, "union": False}
"""By name, whether the halves agree in the middle; otherwise each is as it was, as in the paper."""

DEFAULT_BLEND = "agree"

Offset = tuple[float, float, float]

MOST_LEAD = 3.0

UNSEEN = 1e-6
"""The weight that stands for 0 where splats must stay: never drawn, and its logit is finite."""


class Half(NamedTuple):
    """One half of a morph at one moment, still to be made."""

    splats: Gaussians
    """As many as there will be, of that degree."""
    make: Callable[[Gaussians | None], Gaussians]
    """Makes it, in the room that it gets where it can."""


class Travel(Protocol):
    """Splats some time after their start, made in ``room`` as far as that can be."""

    def __call__(self, t: float, room: Gaussians | None = None) -> Gaussians: ...


@dataclass(frozen=True, eq=False, repr=False)
class Morph:
    """Two splats that become each other, G(t) = G⁰(t) ∪ G¹(t) (eq. 7 of the paper).

    Both splats travel along one flow Φ that takes the source's shape to the target's, and with the
    frame S in which the target stands: the source half is at S(t)∘Φ(x, t), the target half at
    S(t)∘Φ(S⁻¹y, t - 1), and the ramp fades the one out and the other in. With ``blend="union"``,
    ``ramp="linear"`` and ``covariance="fixed"`` that is the paper's morph; the defaults let the
    halves agree, keep the surface solid and let shapes follow the flow. Below 0 only the source is
    left and above 1 only the target, carried on by the same flow: a caricature.

    Raises:
        OptionError: a name that is none of the choices, a threshold of no use, or a time that is
            no finite number.
    """

    source: Gaussians
    """The splats at t = 0, world units."""
    target: Gaussians
    """The splats at t = 1."""
    flow: Flow
    """Φ, fitted from the source's landmarks p to the target's in the source's place, S⁻¹q."""
    _: KW_ONLY
    frame: Similarity = field(default_factory=Similarity.identity)
    """S: where the target stands, how large and which way round, seen from the source."""
    stay: bool = False
    """Keep every frame in the source's place, the target at S⁻¹y; else S(t) is played."""
    ramp: str = DEFAULT_RAMP
    """How opacities fade, a name of ``RAMPS``."""
    covariance: str = DEFAULT_COVARIANCE
    """What the flow does to shape and shading, a name of ``COVARIANCES``."""
    ease: str = "linear"
    """How time runs, a name of ``EASES``."""
    stable_count: bool = False
    """Keep every splat of both in every frame, source before target, those of weight 0 all but
    transparent, for players that want one count and order. The ends are then the inputs plus
    unseen splats."""
    blend: str = DEFAULT_BLEND
    """How the halves meet, a name of ``BLENDS``."""
    landmarks: Tensor | None = None
    """(m, 3) the source's landmarks, where ``agree`` moves nothing beyond the flow."""
    lead: float = 1.0
    """How far ``agree`` leaves a place to the half with the stronger detail, ≥ 0: crisper with
    more, and with 0 both draw it evenly."""
    split: float | None = None
    """Split the splats that the flow stretches on their way from one end to the other beyond so
    many times their length; only strictly between 0 and 1, where a half is fading."""
    _split_halves: dict[int, Gaussians] = field(init=False, default_factory=dict)
    _agreed: list[Agreement] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        chosen(RAMPS, self.ramp, "ramp")
        chosen(COVARIANCES, self.covariance, "covariance")
        chosen(EASES, self.ease, "ease")
        chosen(BLENDS, self.blend, "blend")
        if not 0 <= self.lead <= MOST_LEAD:
            raise OptionError(f"lead is {self.lead}, expected 0 to {MOST_LEAD:g}")
        if self.split is not None and not 1 < self.split < math.inf:
            raise OptionError(
                f"split is {self.split}, expected a number above 1: how many times its length a "
                "splat may grow before it is split"
            )

    def at(self, t: float) -> Gaussians:
        """The morph at t: ``source`` itself at 0 and ``target`` itself at 1, bit for bit."""
        return next(self.sequence([t]))

    def sequence(self, times: Sequence[float]) -> Iterator[Gaussians]:
        """The morphs at ``times``, in their order (any, repeats too), from one integration.

        A time that comes twice in a row gives the same object. A splat that the flow carries to
        infinity raises ``NonFiniteError`` at that frame.
        """
        check_times(times)
        return self._frames(list(map(EASES[self.ease], times)))

    def _frames(self, times: Sequence[float]) -> Iterator[Gaussians]:
        alike = [(t, sum(1 for _ in same)) for t, same in groupby(times)]
        times = [t for t, _ in alike]
        sources = self._half(self.source, times, leaves=1)
        targets = self._half(self.aligned, [t - 1 for t in times], leaves=-1)
        memory = Memory()
        for source, target, (t, count) in zip(sources, targets, alike, strict=True):
            frame = self._placed(source, target, t, memory)
            for _ in range(count):
                yield frame
            del frame  # or the next one couldn't have its memory

    @cached_property
    def aligned(self) -> Gaussians:
        """The target in the source's place, S⁻¹y: what meets the source on the way."""
        moved = self.target.moved(self.frame.inverse())
        return replace(moved, up=self.source.up or moved.up, offset=self.source.offset)

    def in_place(self) -> Morph:
        """The same morph for the source's place alone, which holds no more of the target."""
        return replace(self, target=self.aligned, frame=Similarity.identity(), stay=True)

    @property
    def _degree(self) -> int:
        """Of the harmonics between the ends."""
        return max(self.source.sh_degree, self.target.sh_degree)

    def _placed(
        self, source: Half | None, target: Half | None, t: float, memory: Memory
    ) -> Gaussians:
        """Both halves at t, where and how large they are at that moment."""
        if self.stay:
            return _joined(source, target, memory)
        place = self.frame.power(t)
        if t == 1 and target is not None:
            # S∘S⁻¹ rounds, and the target is to be the target.
            added = target.make(None).select(slice(len(self.target), None))
            others = [added, *([] if source is None else [source.make(None)])]
            offset = self.target.offset
            added, *first = (replace(one.moved(place), offset=offset) for one in others)
            whole = Gaussians.union(self.target, added) if len(added) else self.target
            return Gaussians.union(first[0], whole) if first else whole
        whole = _joined(source, target, memory)
        ours = source is not None and target is not None and Memory.holds(whole)
        whole = whole.moved(place, in_place=ours)
        if self.source.offset == self.target.offset:
            return whole
        return replace(whole, offset=_between(self.source.offset, self.target.offset, t))

    def _half(
        self, gaussians: Gaussians, times: Sequence[float], leaves: int
    ) -> Iterator[Half | None]:
        """One half at ``times`` after its own end of the morph; None where it has faded out.

        ``leaves`` is the direction of time, 1 or -1, in which it fades.
        """
        # A half that is gone needn't travel on: the flow may lead anywhere beyond the other end.
        times = [leaves * min(leaves * t, 1) for t in times]
        weights = [min(1 - leaves * t, 1.0) for t in times]
        least = UNSEEN if self.stable_count else 0.0
        weights = [max(weight, least) for weight in weights]
        timed = list(zip(times, weights, strict=True))
        parts = self._parts(gaussians, leaves).with_sh_degree(self._degree)
        whole = self._travels(gaussians, [t for t, weight in timed if weight == 1])
        fading = self._fading(parts, [t for t, weight in timed if 0 < weight < 1], leaves)
        ramp = RAMPS[self.ramp]
        added = parts.select(slice(len(gaussians), None))
        for t, weight in timed:
            if weight == 0:
                yield None
            elif weight < 1:
                yield Half(parts, partial(fading, t, weight))
            elif self.stable_count and len(added):
                unseen = Gaussians.union(whole(t), ramp(added, UNSEEN))
                yield Half(unseen, partial(_as_it_is, unseen))
            else:
                yield Half(gaussians, partial(whole, t))

    def _parts(self, gaussians: Gaussians, leaves: int) -> Gaussians:
        """What a half consists of while it fades, the same whatever the times."""
        if self.split is None:
            return gaussians
        if leaves not in self._split_halves:
            self._split_halves[leaves] = split_stretched(gaussians, self.flow, leaves, self.split)
        return self._split_halves[leaves]

    def _fading(
        self, parts: Gaussians, times: Sequence[float], leaves: int
    ) -> Callable[[float, float, Gaussians | None], Gaussians]:
        """A half at any of ``times``, faded to a weight, in the room that it gets."""
        ramp = RAMPS[self.ramp]
        agreed = self.agreement()[leaves < 0] if BLENDS[self.blend] and times else None
        travels = self._travels(parts, times, None if agreed is None else agreed.drift)

        def fading(t: float, weight: float, room: Gaussians | None) -> Gaussians:
            exponents = weight if agreed is None else agreed.exponents(weight)
            return ramp(travels(t, room), exponents, room)

        return fading

    def half(self, index: int, t: float) -> Gaussians:
        """The source (0) or the target (1) on its way at t in [0, 1], in the source's place.

        It is not faded, and has taken on as much of the other as it has then in the morph.
        """
        leaves = -1 if index else 1
        parts = self._parts(self.aligned if index else self.source, leaves)
        if not BLENDS[self.blend] or t == index:
            return self._travels(parts, [t - index])(t - index)
        agreed = self.agreement()[index]
        return self._travels(agreed.taken(parts), [t - index], agreed.drift)(t - index)

    def prepare(self, times: Sequence[float], on_step: OnStep | None = None) -> None:
        """Find out what frames at ``times`` need, ahead of the first; no frame is changed by it.

        ``on_step`` is called with the steps done and the steps in all.
        """
        eased = map(EASES[self.ease], times)
        if BLENDS[self.blend] and any(0 < t < 1 for t in eased):
            self.agreement(on_step)

    def agreement(self, on_step: OnStep | None = None) -> tuple[Agreement, Agreement]:
        """How source and target agree, found once; nothing changes where they don't."""
        if not self._agreed:
            ways = ((self.source, 1), (self.aligned, -1))
            rest = [self._parts(half, way).with_sh_degree(self._degree) for half, way in ways]
            if not BLENDS[self.blend]:
                self._agreed.extend(map(Agreement.none, rest))
                return self._agreed[0], self._agreed[1]
            half_way = [(part, way / 2) for part, (_, way) in zip(rest, ways, strict=True)]
            middle = [self._travels(part, [t])(t) for part, t in half_way]
            turns = [colour_turns(part, self.flow, t, self.covariance) for part, t in half_way]
            held = torch.empty(0, 3)
            if self.landmarks is not None:
                held = self.flow.trajectory(self.landmarks, [0.5])[0]
            for agreed in agree(rest, middle, turns, held, on_step):
                lead = (self.lead * agreed.lead.logit()).sigmoid()
                self._agreed.append(replace(agreed, lead=lead))
        return self._agreed[0], self._agreed[1]

    def with_ramp(self, ramp: str) -> Morph:
        """The same morph under another ramp, with what was found out about it already."""
        other = replace(self, ramp=ramp)
        other._split_halves.update(self._split_halves)
        other._agreed.extend(self._agreed)
        return other

    def _travels(
        self, gaussians: Gaussians, times: Sequence[float], drift: Drift | None = None
    ) -> Travel:
        """The splats at any of ``times`` after their start, from one integration."""
        stops = sorted({t for t in times if t != 0})
        transport = COVARIANCES[self.covariance]
        frame = transport(gaussians, self.flow, stops, drift) if stops else None

        def at(t: float, room: Gaussians | None = None) -> Gaussians:
            if frame is None or t == 0:
                return gaussians
            moved = frame(stops.index(t), room)
            with one_thread():  # others would take a core from the kernels for a while
                if moved.means.sum().isfinite():
                    return moved
            # Either some are lost, or the sum has overflowed.
            lost = len(moved) - int(moved.means.isfinite().all(1).sum())
            if lost:
                raise NonFiniteError(
                    f"the flow carries {lost} of {len(moved)} splats to infinity: expected t "
                    "closer to [0, 1], or landmarks nearer to each other"
                )
            return moved

        return at


def _joined(source: Half | None, target: Half | None, memory: Memory) -> Gaussians:
    """Both halves, made where they lie one behind the other."""
    if source is None or target is None:
        (whole,) = (half for half in (source, target) if half is not None)
        return whole.make(None)
    ends = source.splats, target.splats
    if not all(map(Memory.holds, ends)):
        return Gaussians.union(source.make(None), target.make(None))
    degree = max(end.sh_degree for end in ends)
    room = memory.splats(sum(map(len, ends)), degree)
    parts = room.select(slice(len(ends[0]))), room.select(slice(len(ends[0]), None))
    first, second = (
        half.make(part if half.splats.sh_degree == degree else None)
        for half, part in zip((source, target), parts, strict=True)
    )
    return Gaussians.union(first, second, room)


def _as_it_is(gaussians: Gaussians, room: Gaussians | None) -> Gaussians:
    return gaussians


def _between(start: Offset, end: Offset, t: float) -> Offset:
    # The mean is exact at both ends.
    x, y, z = ((1 - t) * a + t * b for a, b in zip(start, end, strict=True))
    return x, y, z


def check_times(times: Sequence[float]) -> None:
    """Raise ``OptionError`` where a time is no finite number."""
    for t in times:
        if not math.isfinite(t):
            raise OptionError(f"t is {t}, expected a finite number (0 is the source, 1 the target)")


def chosen(choices: Mapping[str, Choice], name: str, noun: str) -> Choice:
    """The choice called ``name``; raises ``OptionError`` that lists them if there is none."""
    if name not in choices:
        raise OptionError(f"{noun} '{name}' is not one of: {', '.join(choices)}")
    return choices[name]
