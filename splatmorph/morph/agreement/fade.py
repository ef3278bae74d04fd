"""Fade: what has no counterpart goes in proportion to time, and not at the very end.

A stack of splats lets through e^-d, d being its density. Under one exponent x for all of them it
lets through e^-xd: a body ten deep is opaque until x is small. Its coverage falls in proportion
to its weight w, as 1 - e^-xd = w (1 - e^-d), for the exponent

    x(w, d) = -ln(1 - w (1 - e^-d)) / d,        x(w, 0) = w.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from splatmorph.gaussians import Gaussians
from splatmorph.morph.agreement.neighbours import Neighbours
from splatmorph.morph.agreement.views import View
from splatmorph.morph.ramps import DENSEST, scaled_logits
from splatmorph.rendering import renderer_arrays

THINNED = 0.25
"""The exponent under which stacks are looked through."""

ROUNDS = 4

DENSEST_STACK = 60.0


def exponents(weight: float | Tensor, density: Tensor) -> Tensor:
    """x(w, d) of splats that stand in stacks of ``density`` (n,), for weights w in [0, 1]."""
    stack = density.clamp_min(1e-3)
    found = -torch.log1p(weight * torch.expm1(-stack)) / stack
    return torch.where(density > 1e-3, found, weight)


def densities(part: Gaussians, alone: Tensor, views: Sequence[View], around: Neighbours) -> Tensor:
    """The density (n,) of the stack that each splat stands in, 0 for what has a counterpart.

    Found such that at half time every pixel of what stands ``alone`` (n,) is half as covered, as
    closely as one exponent a splat can do it: each is scaled by the mean of what its pixels want,
    round by round.
    """
    exponent = torch.full((len(part),), 0.5)
    if not (alone > 0).any():
        return torch.zeros(len(part))
    lone = faded(part, alone)
    whole = [_density(lone, view) for view in views]
    looked_through = renderer_arrays(faded(part, alone * THINNED))
    for _ in range(ROUNDS):
        now = faded(part, alone * exponent)
        sums = torch.zeros(len(part), 2)
        for view, d in zip(views, whole, strict=True):
            wanted = -torch.log1p(0.5 * torch.expm1(-d))
            scale = (wanted / _density(now, view).clamp_min(1e-3)).clamp(0.05, 2).log()
            there = (d > 0.02).float()
            sums += view.gather(looked_through, [scale * there, there])
        step, seen = sums.unbind(1)
        step = around.means((step / seen.clamp_min(1e-6))[:, None], seen / (seen + 1))[:, 0]
        exponent = (exponent * step.exp()).clamp(1e-3, 0.5)
    return _density_of(torch.lerp(torch.full_like(exponent, 0.5), exponent, alone))


def faded(part: Gaussians, exponent: Tensor) -> Gaussians:
    """Splats that let through to the power of ``exponent`` (n,) what they did."""
    drawn = part.opacities.clamp(1e-12, DENSEST)
    factor = (-torch.expm1(exponent * torch.log1p(-drawn)) / drawn).clamp(1e-9, 1 - 1e-7)
    return replace(part, opacity_logits=scaled_logits(part.opacity_logits, factor.log()))


def _density(part: Gaussians, view: View) -> Tensor:
    """-ln of what a stack lets through at each pixel, looked at thinned, as it may be opaque."""
    thin = faded(part, torch.full((len(part),), THINNED))
    alpha = view.picture(renderer_arrays(thin)).alpha
    return -torch.log1p(-alpha.clamp_max(1 - 1e-6)) / THINNED


def _density_of(exponent: Tensor) -> Tensor:
    """The density d whose x(1/2, d) is ``exponent`` (n,)."""
    densities = torch.cat([torch.zeros(1), torch.logspace(-2, math.log10(DENSEST_STACK), 200)])
    table = exponents(0.5, densities)
    place = torch.searchsorted(-table, -exponent).clamp(1, len(table) - 1)
    low, high = table[place - 1], table[place]
    share = ((low - exponent) / (low - high)).clamp(0, 1)
    return torch.lerp(densities[place - 1], densities[place], share)
