"""Agreement: the two halves of a morph become one thing in the middle.

The union of the paper (eq. 7) keeps both halves as they are: where their surfaces nearly coincide
the eye sees now the one and now the other. Here each half takes on, linearly in time and from its
own end, what the other shows in its place: its colour, and its surface where landmarks left a gap.
And each place is drawn by the half that has more to say there.

Everything is decided once a morph, at the middle shape, where both halves are carried half way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count

import torch
from torch import Tensor

from splatmorph.gaussians import FAINTEST_DRAWN, Gaussians
from splatmorph.geometry.harmonics import SH0, rotate_sh
from splatmorph.morph.agreement import colour, fade, lead, melt
from splatmorph.morph.agreement.neighbours import Neighbours
from splatmorph.morph.agreement.views import SIZE, views_of
from splatmorph.morph.paths import Drift
from splatmorph.morph.transport import drifted
from splatmorph.rendering import bounds, renderer_arrays
from splatmorph.steady import one_thread

ALL_BUT_ONE = 1 - 2**-23
"""The largest weight below 1 in single precision: at 1 itself a stack's exponent is infinite."""

OnStep = Callable[[int, int], None]
"""Called with the steps done and the steps in all."""

Tick = Callable[[], None]


@dataclass(frozen=True)
class Agreement:
    """What becomes of one half on its way to the other end."""

    drift: Drift
    lead: Tensor
    """(n,) in (0, 1): the half's weight in the middle; the other has 1 minus that there."""
    density: Tensor
    """(n,) ≥ 0: of the stack that a splat without counterpart stands in; see ``fade``."""

    @staticmethod
    def none(half: Gaussians) -> Agreement:
        """Nothing becomes of it."""
        n = len(half)
        drift = Drift(torch.zeros(n, 3), torch.zeros(n, 3, 3), torch.zeros_like(half.sh))
        return Agreement(drift, torch.full((n,), 0.5), torch.zeros(n))

    def select(self, index: Tensor) -> Agreement:
        """That of the splats at ``index``."""
        drift = Drift(*(each[index] for each in vars(self.drift).values()))
        return Agreement(drift, self.lead[index], self.density[index])

    def taken(self, half: Gaussians) -> Gaussians:
        """The half with room for the harmonics that it takes on."""
        return half.with_sh_degree(math.isqrt(self.drift.sh.shape[1]) - 1)

    @cached_property
    def _log_odds(self) -> Tensor:
        return self.lead.logit()

    @one_thread()
    def exponents(self, weight: float) -> Tensor:
        """How much of each splat is left when ``weight`` in (0, 1) of the half is: (n,)."""
        # The lead is that of the middle: towards the ends each half is whole.
        swing = (4 * weight * (1 - weight)) ** 2
        odds = swing * self._log_odds + math.log(weight / (1 - weight))
        return fade.exponents(odds.sigmoid().clamp_max(ALL_BUT_ONE), self.density)


class Meeting:
    """Parts at the shape that they have in common, and what brings them together there.

    Arguments:
        rest: the parts, each at its own end.
        middle: the same, carried to the common shape; one SH degree for all.
        turns: (n, 3, 3) each: how far the carrying turned their colours; None: not at all.
        goals: for each part how much it takes on of each other (nothing of itself) at its
            other end: sums to 1 in a morph, where each becomes the other.
        way: how much of that it has taken on at the common shape.
        held: (m, 3) points of the common shape where nothing melts: the landmarks.
        tick: called after each of ``steps``.
    """

    @staticmethod
    def steps(parts: int) -> int:
        """How many steps it takes for so many parts."""
        return 1 + parts * (1 + colour.ROUNDS)

    def __init__(
        self,
        rest: Sequence[Gaussians],
        middle: Sequence[Gaussians],
        turns: Sequence[Tensor | None],
        goals: Sequence[Sequence[float]],
        way: float,
        held: Tensor,
        tick: Tick,
    ) -> None:
        rest, middle = (list(map(_on_cpu, parts)) for parts in (rest, middle))
        around = bounds(*middle)
        self.views, radius = views_of(around), around.radius
        self.coarse = views_of(around, size=SIZE // 2)
        self.near = [Neighbours(part) for part in middle]
        offsets, self.alone = melt.offsets(middle, self.near, goals, radius, held)
        self.parts = [
            replace(part, means=part.means + way * offset)
            for part, offset in zip(middle, offsets, strict=True)
        ]
        tick()
        self.shown, self.small = [], []
        for arrays in map(renderer_arrays, self.parts):
            self.shown.append([view.picture(arrays) for view in self.views])
            self.small.append([view.picture(arrays) for view in self.coarse])
            tick()
        self.drifts = []
        for i, (start, offset) in enumerate(zip(rest, offsets, strict=True)):
            slope = melt.slopes(start, offset, self.near[i])
            sh = self._recoloured(i, goals[i], radius, tick)
            turn = turns[i]
            if turn is not None and start.sh_degree:
                sh = rotate_sh(sh, turn.mT)
            self.drifts.append(Drift(offset, slope, sh))

    def _recoloured(self, i: int, shares: Sequence[float], radius: float, tick: Tick) -> Tensor:
        """The change (n, k, 3) of the colours of part ``i`` at the common shape."""
        part, near, mine = self.parts[i], self.near[i], self.small[i]
        kept = [j for j, share in enumerate(shares) if share and j != i]
        shares = [shares[j] for j in kept]
        goals = [
            colour.goal(own, [self.small[j][k] for j in kept], shares, radius)
            for k, own in enumerate(mine)
        ]
        changed, trust = colour.change(part, self.coarse, mine, goals, near, tick)
        sh = changed[:, None] / SH0
        if part.sh_degree:
            others = [self.parts[j] for j in kept]
            bands = colour.view_dependence(part, others, shares, near)
            sh = torch.cat([sh, trust[:, None, None] * bands], 1)
        return sh


def _ticks(total: int, on_step: OnStep | None) -> Tick:
    steps = count(1)
    return lambda: on_step(next(steps), total) if on_step else None


def _on_cpu(gaussians: Gaussians) -> Gaussians:
    names = ("means", "quats", "log_scales", "opacity_logits", "sh")
    fields = {name: getattr(gaussians, name).detach().float().cpu() for name in names}
    return Gaussians(**fields)


@one_thread()
@torch.no_grad()
def agree(
    rest: Sequence[Gaussians],
    middle: Sequence[Gaussians],
    turns: Sequence[Tensor | None],
    held: Tensor,
    on_step: OnStep | None = None,
) -> list[Agreement]:
    """How the two halves of a morph agree; arguments as for ``Meeting``."""
    if not any((part.opacities > FAINTEST_DRAWN).any() for part in middle):
        return [Agreement.none(half) for half in rest]
    tick = _ticks(Meeting.steps(2) + 3, on_step)
    meeting = Meeting(rest, middle, turns, [[0, 1], [1, 0]], 0.5, held, tick)
    leads = lead.leads(meeting.parts, meeting.views, meeting.shown, meeting.near)
    tick()
    densities = []
    for part, alone, near in zip(meeting.parts, meeting.alone, meeting.near, strict=True):
        densities.append(fade.densities(part, alone, meeting.coarse, near))
        tick()
    return [Agreement(*parts) for parts in zip(meeting.drifts, leads, densities, strict=True)]


@one_thread()
@torch.no_grad()
def agreed_parts(
    parts: Sequence[Gaussians],
    weights: Sequence[float],
    held: Tensor,
    *,
    stretch: bool,
    on_step: OnStep | None = None,
) -> list[Gaussians]:
    """Parts that agree, to be averaged.

    Arguments:
        parts: all at the common shape.
        weights: how much of each there is, summing to 1.
        held: (m, 3) the landmarks there.
        stretch: whether shapes follow where their centers go.
    """
    degree = max(part.sh_degree for part in parts)
    parts = [part.with_sh_degree(degree) for part in parts]
    goals = [[w * (i != j) for j, w in enumerate(weights)] for i in range(len(weights))]
    tick = _ticks(Meeting.steps(len(parts)), on_step)
    meeting = Meeting(parts, parts, [None] * len(parts), goals, 1.0, held, tick)
    return [
        drifted(part, drift, stretch=stretch)
        for part, drift in zip(parts, meeting.drifts, strict=True)
    ]
