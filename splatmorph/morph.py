"""Morph: two splats and a flow, and the splats in between."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TypeVar

from splatmorph.errors import NonFiniteError, OptionError
from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians
from splatmorph.ramps import DEFAULT_RAMP, EASES, RAMPS
from splatmorph.transport import COVARIANCES, DEFAULT_COVARIANCE

Choice = TypeVar("Choice")

UNSEEN = 1e-6
"""The weight that stands for 0 where splats must stay: never drawn, and its logit is finite."""


class Morph:
    """The union blend of the paper (eq. 7), G(t) = G⁰(t) ∪ G¹(t).

    Both splats travel along one flow Φ that takes the source's shape to the target's: the source
    half stands at Φ(x, t), the target half at Φ(x, t - 1), and the ramp fades the one out and the
    other in. With ``ramp="linear"`` and ``covariance="fixed"`` that is the paper's morph; the
    defaults keep the surface solid and let shapes follow the flow. Below 0 only the source is
    left and above 1 only the target, carried on by the same flow: a caricature.

    Arguments:
        source, target: the splats at t = 0 and t = 1, world units.
        flow: Φ, fitted from the source's landmarks to the target's.
        ramp: how opacities fade, a name of ``RAMPS``.
        covariance: what the flow does to shape and shading, a name of ``COVARIANCES``.
        ease: how time runs, a name of ``EASES``.
        stable_count: keep every splat of both in every frame, source before target, those of
            weight 0 all but transparent, for players that want one count and order. The ends
            are then the inputs plus unseen splats.

    Raises:
        OptionError: a name that is none of these, or a time that is no finite number.
    """

    def __init__(
        self,
        source: Gaussians,
        target: Gaussians,
        flow: Flow,
        *,
        ramp: str = DEFAULT_RAMP,
        covariance: str = DEFAULT_COVARIANCE,
        ease: str = "linear",
        stable_count: bool = False,
    ) -> None:
        self.source = source
        self.target = target
        self.flow = flow
        self.ramp = ramp
        self.covariance = covariance
        self.stable_count = stable_count
        self._ramp = chosen(RAMPS, ramp, "ramp")
        self._transport = chosen(COVARIANCES, covariance, "covariance")
        self._ease = chosen(EASES, ease, "ease")

    def at(self, t: float) -> Gaussians:
        """The morph at t: ``source`` itself at 0 and ``target`` itself at 1, bit for bit."""
        return next(self.sequence([t]))

    def sequence(self, times: Sequence[float]) -> Iterator[Gaussians]:
        """The morphs at ``times``, in their order (any, repeats too), from one integration.

        A splat that the flow carries to infinity raises ``NonFiniteError`` at that frame.
        """
        check_times(times)
        eased = [self._ease(t) for t in times]
        sources = self._half(self.source, eased, leaves=1)
        targets = self._half(self.target, [t - 1 for t in eased], leaves=-1)
        return map(_joined, sources, targets)

    def _half(
        self, gaussians: Gaussians, times: Sequence[float], leaves: int
    ) -> Iterator[Gaussians | None]:
        """One half at ``times`` after its own end of the morph; None where it has faded out.

        ``leaves`` is the direction of time, 1 or -1, in which it fades.
        """
        # A half that is gone needn't travel on: the flow may lead anywhere beyond the other end.
        times = [leaves * min(leaves * t, 1) for t in times]
        weights = [min(1 - leaves * t, 1.0) for t in times]
        shown = [weight > 0 or self.stable_count for weight in weights]
        stops = sorted({t for t, seen in zip(times, shown, strict=True) if seen and t != 0})
        frame = self._transport(gaussians, self.flow, stops) if stops else None
        for t, weight, seen in zip(times, weights, shown, strict=True):
            if not seen:
                yield None
                continue
            moved = gaussians if frame is None or t == 0 else frame(stops.index(t))
            lost = len(moved) - int(moved.means.isfinite().all(1).sum())
            if lost:
                raise NonFiniteError(
                    f"the flow carries {lost} of {len(moved)} splats to infinity: expected t "
                    "closer to [0, 1], or landmarks nearer to each other"
                )
            yield moved if weight == 1 else self._ramp(moved, max(weight, UNSEEN))


def _joined(source: Gaussians | None, target: Gaussians | None) -> Gaussians:
    if source is None or target is None:
        (whole,) = (half for half in (source, target) if half is not None)
        return whole
    return Gaussians.union(source, target)


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
