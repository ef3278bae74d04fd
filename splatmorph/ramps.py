"""Ramps fade the two halves of a morph; eases bend its time.

A ramp takes splats and a weight w in (0, 1) and returns them faded to that weight; the two halves
of a morph get w = 1 - t and w = t. Weights 1 and 0 are never asked for: there a half is the input
itself, bit for bit, or gone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import torch
from torch import Tensor
from torch.nn.functional import logsigmoid

from splatmorph.gaussians import Gaussians

Ramp = Callable[[Gaussians, float], Gaussians]
Ease = Callable[[float], float]


def scaled_logits(logits: Tensor, log_factor: Tensor) -> Tensor:
    """Logits (n,) of f·σ(logits), for factors f ≤ 1 given by their logarithm (n,) or ().

    In logarithms, since σ of a saturated logit is 1 in floating point and its logit is lost:
    logit(f·σ(l)) = log f + log σ(l) - log((1 - f) + f·σ(-l)).
    """
    factor = log_factor.exp()
    remainder = torch.log(-torch.expm1(log_factor) + factor * torch.sigmoid(-logits))
    return log_factor + logsigmoid(logits) - remainder


def linear(gaussians: Gaussians, weight: float) -> Gaussians:
    """The paper's ramp (eq. 7): the opacity α becomes w·α."""
    logits = gaussians.opacity_logits
    log_weight = torch.tensor(weight, dtype=logits.dtype, device=logits.device).log()
    return replace(gaussians, opacity_logits=scaled_logits(logits, log_weight))


def smoothstep(t: float) -> float:
    """3t² - 2t³ within [0, 1]: starts and stops at rest. Outside, t itself."""
    return t * t * (3 - 2 * t) if 0 < t < 1 else t


def smootherstep(t: float) -> float:
    """6t⁵ - 15t⁴ + 10t³ within [0, 1]: starts and stops without a jerk. Outside, t itself."""
    return t**3 * (t * (6 * t - 15) + 10) if 0 < t < 1 else t


RAMPS: Mapping[str, Ramp] = MappingProxyType({"linear": linear})
"""The ramps by name."""

EASES: Mapping[str, Ease] = MappingProxyType(
    {"linear": lambda t: t, "smooth": smoothstep, "smoother": smootherstep}
)
"""The eases by name: each maps [0, 1] onto itself, rising, and leaves other t as they are."""
