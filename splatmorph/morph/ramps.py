"""Ramps fade the two halves of a morph; eases bend its time.

A ramp takes splats and a weight w in (0, 1), one for all or one each, and returns them faded to
that weight; the two halves of a morph get w = 1 - t and w = t. Weights 1 and 0 are never asked
for: there a half is the input itself, bit for bit, or gone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import Protocol

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import logsigmoid

from splatmorph.gaussians import FAINTEST_DRAWN, Gaussians
from splatmorph.morph.native.fade import Fade
from splatmorph.steady import one_thread

DENSEST = 0.99
"""Renderers draw no splat more opaque than this."""

STEPS = 128
"""Intervals of the tables of ``calibrated``."""

WEIGHTS = 64
"""Intervals of weight, where each splat has its own."""

_native = Fade(STEPS, WEIGHTS, DENSEST, FAINTEST_DRAWN)

Weight = float | Tensor


class Ramp(Protocol):
    """Splats faded to a weight; what it can, it makes in ``room``, of as many splats."""

    def __call__(
        self, gaussians: Gaussians, weight: Weight, room: Gaussians | None = None
    ) -> Gaussians: ...


Ease = Callable[[float], float]


def scaled_logits(logits: Tensor, log_factor: Tensor) -> Tensor:
    """Logits (n,) of f·σ(logits), for factors f ≤ 1 given by their logarithm (n,) or ().

    In logarithms, since σ of a saturated logit is 1 in floating point and its logit is lost:
    logit(f·σ(l)) = log f + log σ(l) - log((1 - f) + f·σ(-l)).
    """
    factor = log_factor.exp()
    remainder = torch.log(-torch.expm1(log_factor) + factor * torch.sigmoid(-logits))
    return log_factor + logsigmoid(logits) - remainder


def linear(gaussians: Gaussians, weight: Weight, room: Gaussians | None = None) -> Gaussians:
    """The paper's ramp (eq. 7): the opacity α becomes w·α.

    Two such copies of one surface are thinner than the surface: 1 - (1 - wα)(1 - (1-w)α) < α.
    """
    log_weight = weight.log() if isinstance(weight, Tensor) else math.log(weight)
    return _scaled(gaussians, torch.zeros_like(gaussians.opacity_logits) + log_weight)


def power(gaussians: Gaussians, weight: Weight, room: Gaussians | None = None) -> Gaussians:
    """The opacity α becomes 1 - (1 - α)^w: the transmittances of the halves multiply to 1 - α.

    So the peak of a splat is kept, but its flanks, where α is small, swell.
    """
    drawn = _drawn_opacities(gaussians)
    return _scaled(gaussians, (-torch.expm1(weight * torch.log1p(-drawn)) / drawn).log())


def calibrated(gaussians: Gaussians, weight: Weight, room: Gaussians | None = None) -> Gaussians:
    """A splat morphed into itself looks like itself: opacities fade and splats narrow.

    With G the Gaussian's profile, the profile 1 - (1 - αG)^w would be exact: two copies with
    weights w and 1 - w then let through (1 - αG)^w (1 - αG)^(1-w) = 1 - αG everywhere. It is no
    Gaussian; this ramp gives each splat the Gaussian a·G^k of the same integral and the same
    variance over the picture. Since renderers skip what is fainter than 1/255, two copies lose
    their edges twice: the lost rim is given back by raising faint splats by 1/255, as far as
    neither copy exceeds its α.
    """
    logits, log_scales = gaussians.opacity_logits, gaussians.log_scales
    if _native.takes(logits, log_scales):
        own = weight if isinstance(weight, Tensor) else None
        table = _best_gaussians(float(weight)) if own is None else _all_weights()
        out = None if room is None else (room.opacity_logits, room.log_scales)
        logits, log_scales = _native(logits, log_scales, table, own, out)
        return replace(gaussians, opacity_logits=logits, log_scales=log_scales)
    drawn = _drawn_opacities(gaussians)
    if isinstance(weight, Tensor):
        factor, narrowing, other = _between(weight.to(drawn), drawn)
    else:
        factor, narrowing, other = interpolated(_best_gaussians(weight), drawn)
    factor = torch.minimum(factor * (1 + FAINTEST_DRAWN / drawn), factor / other).clamp_max(1)
    faded = _scaled(gaussians, factor.log())
    return replace(faded, log_scales=faded.log_scales - 0.5 * narrowing.log()[:, None])


def _between(weights: Tensor, alpha: Tensor) -> tuple[Tensor, ...]:
    """``_best_gaussians`` at one weight and one opacity each (n,): three times (n,)."""
    place = (weights * WEIGHTS).clamp(1, WEIGHTS - 1)
    left = place.int().clamp_max(WEIGHTS - 2)
    share = place - left
    column = alpha * (STEPS / DENSEST)
    low = column.int().clamp_max(STEPS - 1)
    table = _all_weights().to(alpha).flatten(0, 1)
    corner = (left - 1) * (STEPS + 1) + low
    below, above = (
        torch.lerp(
            table.index_select(0, at), table.index_select(0, at + 1), (column - low)[:, None]
        )
        for at in (corner, corner + STEPS + 1)
    )
    factor, narrowing, other = torch.lerp(below, above, share[:, None]).unbind(1)
    # Before the first weight of the table and after its last, straight on to 0 and to 1.
    faint, near = (weights * WEIGHTS).clamp_max(1), ((1 - weights) * WEIGHTS).clamp_max(1)
    factor = faint * (1 - (1 - factor) * near)
    other = near * (1 - (1 - other) * faint)
    return factor.clamp_min(1e-12), 1 + (narrowing - 1) * near, other.clamp_min(1e-12)


@lru_cache
def _all_weights() -> Tensor:
    """``_best_gaussians`` for the weights k/WEIGHTS, 0 < k < WEIGHTS."""
    return torch.stack([_best_gaussians(k / WEIGHTS) for k in range(1, WEIGHTS)])


@one_thread()  # to wake others costs more than the work
def _best_gaussians(weight: float) -> Tensor:
    """a/α and k of ``calibrated``, and a/α for 1 - w, for α = 0 … DENSEST: (STEPS + 1, 3) float64.

    Over the plane the area element is dx for G = e⁻ˣ, so the Gaussian a·G^k has the integral a/k
    and the variance 1/k. Those of f(G) = 1 - (1 - αG)^w are integrals over G in (0, 1) with
    dx = -dG/G, by Gauss-Legendre in s with 1 - G = (1 - s²)², which smooths both ends.
    """
    nodes, weights = _GAUSS_LEGENDRE
    s = 0.5 * (nodes + 1)
    profile = 1 - (1 - s**2) ** 2
    step = 2 * weights * s * (1 - s**2) / profile
    alpha = torch.linspace(0, DENSEST, STEPS + 1, dtype=torch.float64).clamp_min(1e-6)
    both = torch.tensor([weight, 1 - weight], dtype=torch.float64)[:, None, None]
    faded = -torch.expm1(both * torch.log1p(-alpha[:, None] * profile))
    integral = faded @ step
    variance = faded @ (-step * profile.log()) / integral
    factor = integral / variance / alpha
    return torch.stack([factor[0], 1 / variance[0], factor[1]], 1)


_GAUSS_LEGENDRE = tuple(map(torch.from_numpy, np.polynomial.legendre.leggauss(16)))


def interpolated(table: Tensor, alpha: Tensor) -> tuple[Tensor, ...]:
    """Columns of a table over α = 0 … DENSEST, (STEPS + 1, c), at α (n,): c times (n,)."""
    place = alpha * (STEPS / DENSEST)
    left = place.int().clamp_max(STEPS - 1)
    table = table.to(alpha)
    rise = table.diff(dim=0)
    values = table.index_select(0, left)
    return torch.addcmul(values, rise.index_select(0, left), (place - left)[:, None]).unbind(1)


def _drawn_opacities(gaussians: Gaussians) -> Tensor:
    """(n,) opacities as renderers take them, more than DENSEST being DENSEST; never quite 0."""
    return gaussians.opacities.clamp(1e-12, DENSEST)


def _scaled(gaussians: Gaussians, log_factor: Tensor) -> Gaussians:
    return replace(gaussians, opacity_logits=scaled_logits(gaussians.opacity_logits, log_factor))


def smoothstep(t: float) -> float:
    """3t² - 2t³ within [0, 1]: starts and stops at rest. Outside, t itself."""
    return t * t * (3 - 2 * t) if 0 < t < 1 else t


def smootherstep(t: float) -> float:
    """6t⁵ - 15t⁴ + 10t³ within [0, 1]: starts and stops without a jerk. Outside, t itself."""
    return t**3 * (t * (6 * t - 15) + 10) if 0 < t < 1 else t


RAMPS: Mapping[str, Ramp] = MappingProxyType(
    {"linear": linear, "power": power, "calibrated": calibrated}
)
"""The ramps by name."""

DEFAULT_RAMP = "calibrated"
"""The ramp that keeps a surface solid; the paper's is ``linear``."""

EASES: Mapping[str, Ease] = MappingProxyType(
    {"linear": lambda t: t, "smooth": smoothstep, "smoother": smootherstep}
)
"""The eases by name: each maps [0, 1] onto itself, rising, and leaves other t as they are."""
