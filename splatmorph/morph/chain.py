"""Several splats: a chain that visits one after the other, and their average."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import reduce
from itertools import accumulate, pairwise

import torch
from torch import Tensor

from splatmorph.errors import LandmarkError, OptionError
from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.alignment import similarity_between
from splatmorph.geometry.similarity import Similarity
from splatmorph.landmarks import FEWEST, Landmarks
from splatmorph.morph.agreement import OnStep, agreed_parts
from splatmorph.morph.morph import BLENDS, DEFAULT_BLEND, Morph, check_times, chosen
from splatmorph.morph.ramps import DEFAULT_RAMP, RAMPS
from splatmorph.morph.transport import COVARIANCES, DEFAULT_COVARIANCE


class Chain:
    """Morphs end to end, A → B → C …, as one morph with t from 0 at A to n - 1 at the n-th.

    At a whole t it is that splat itself, bit for bit; below 0 and above n - 1 the first and the
    last morph go on. Where the legs stay in their source's place, the chain stays in the first's.

    Arguments:
        morphs: the legs in order, each with the target of the one before as its source. An ease
            of theirs slows time at every splat.

    Raises:
        OptionError: a leg keeps a stable count, which a chain has not: other splats come and go.
    """

    def __init__(self, morphs: Sequence[Morph]) -> None:
        if not morphs:
            raise ValueError("a chain needs at least one morph")
        for before, after in pairwise(morphs):
            if before.target is not after.source:
                raise ValueError("each morph of a chain begins with the splat where one ended")
        if len({morph.stay for morph in morphs}) > 1:
            raise ValueError("the legs of a chain stay in place all or none")
        if len(morphs) > 1 and any(morph.stable_count for morph in morphs):
            raise OptionError("a chain of several morphs has no stable count: export them singly")
        self.morphs = tuple(morphs)
        steps = (morph.frame.inverse() for morph in morphs[:-1])
        self._places = list(accumulate(steps, Similarity.__matmul__, initial=Similarity.identity()))

    def at(self, t: float) -> Gaussians:
        """The chain at t in [0, n - 1], or beyond."""
        return next(self.sequence([t]))

    def sequence(self, times: Sequence[float]) -> Iterator[Gaussians]:
        """The chain at ``times``, in their order, from one integration a leg."""
        legs, own = self._by_leg(times)
        frames = {leg: self.morphs[leg].sequence(times) for leg, times in own.items()}
        return (self._placed(next(frames[leg]), leg) for leg in legs)

    def prepare(self, times: Sequence[float], on_step: OnStep | None = None) -> None:
        """``Morph.prepare`` of each leg in turn."""
        for leg, own in self._by_leg(times)[1].items():
            self.morphs[leg].prepare(own, on_step)

    def in_place(self) -> Chain:
        """The chain itself: of two legs neither can let go of the splat between them."""
        return self

    def _by_leg(self, times: Sequence[float]) -> tuple[list[int], dict[int, list[float]]]:
        """On which leg each of ``times`` is, and the times of each leg from its own start."""
        check_times(times)
        legs = [min(max(math.floor(t), 0), len(self.morphs) - 1) for t in times]
        own: dict[int, list[float]] = {leg: [] for leg in legs}
        for t, leg in zip(times, legs, strict=True):
            own[leg].append(t - leg)
        return legs, own

    def _placed(self, frame: Gaussians, leg: int) -> Gaussians:
        if leg == 0 or not self.morphs[0].stay:
            return frame
        first = self.morphs[0].source
        moved = frame.moved(self._places[leg])
        return replace(moved, up=first.up or moved.up, offset=first.offset)


def average(
    splats: Sequence[Gaussians],
    flows: Sequence[Flow],
    weights: Sequence[float] | None = None,
    *,
    frames: Sequence[Similarity] | None = None,
    ramp: str = DEFAULT_RAMP,
    covariance: str = DEFAULT_COVARIANCE,
    blend: str = DEFAULT_BLEND,
    landmarks: Tensor | None = None,
    on_step: OnStep | None = None,
) -> Gaussians:
    """One splat that is the average of several.

    Arguments:
        splats: what to average.
        flows: as many; each carries its splat at t = 1 to the shape they have in common, that of
            ``mean_landmarks`` say.
        weights: how much of each, ≥ 0; divided by their sum. Equal ones if not given.
        frames: where the common shape stands, seen from each splat; in its place if not given.
        ramp, covariance, blend: as for ``Morph``; the ramp fades each splat to its weight.
        landmarks: (m, 3) the first splat's, where ``agree`` moves nothing beyond the flows.
        on_step: called with the steps done and the steps in all while parts are made to agree.

    Raises:
        OptionError: a name that is none of the choices, or weights that are no proportions.
    """
    fade, transport = chosen(RAMPS, ramp, "ramp"), chosen(COVARIANCES, covariance, "covariance")
    weights = [1.0] * len(splats) if weights is None else weights
    frames = [Similarity.identity()] * len(splats) if frames is None else frames
    if not len(splats) == len(flows) == len(weights) == len(frames):
        raise ValueError(f"{len(splats)} splats, {len(flows)} flows, {len(weights)} weights")
    total = sum(weights)
    if not (math.isfinite(total) and total > 0 and min(weights) >= 0):
        raise OptionError(f"weights are {list(weights)}, expected proportions ≥ 0, not all 0")
    drawn = [i for i, weight in enumerate(weights) if weight > 0]
    shares = [weights[i] / total for i in drawn]
    parts = []
    for i in drawn:
        moved = transport(splats[i], flows[i], [1.0])(0).moved(frames[i])
        parts.append(replace(moved, offset=splats[0].offset))
    if len(parts) == 1:
        return parts[0]
    if chosen(BLENDS, blend, "blend"):
        held = torch.empty(0, 3)
        if landmarks is not None:
            held = frames[0](flows[0].trajectory(landmarks, [1.0])[0])
        stretch = covariance == "full"
        parts = agreed_parts(parts, shares, held, stretch=stretch, on_step=on_step)
    return reduce(Gaussians.union, map(fade, parts, shares))


def mean_landmarks(sets: Sequence[Landmarks]) -> Landmarks:
    """The mean shape of all sets over the landmarks that they share, in the order of the first.

    The sets are brought into one place by similarities, and their mean is put where, and made as
    large as, they are on average: exp of the mean logarithm. Captures that share a frame have
    there the mean of each landmark, but for what they turn against each other.

    Raises:
        LandmarkError: a set has no names, too few are common to all, or one mirrors the first.
    """
    if any(one.names is None for one in sets):
        raise LandmarkError("landmarks without names have no mean: expected named ones in all sets")
    places = [{name: i for i, name in enumerate(one.names or ())} for one in sets]
    names = [name for name in places[0] if all(name in place for place in places)]
    dim = sets[0].dim
    if len(names) < FEWEST[dim]:
        raise LandmarkError(
            f"{len(names)} landmark names are common to all {len(sets)} sets, expected at least "
            f"{FEWEST[dim]}"
        )
    points = [
        one.points[[place[name] for name in names]] for one, place in zip(sets, places, strict=True)
    ]
    frames = [similarity_between(points[0], one) for one in points]
    aligned = [frame.inverse()(one) for frame, one in zip(frames, points, strict=True)]
    amidst = Similarity.exp(torch.stack([frame.log() for frame in frames]).mean(0))
    return Landmarks(amidst(torch.stack(aligned).mean(0)), tuple(names))
