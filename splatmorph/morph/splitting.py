"""Splitting: a splat that the flow stretches far becomes several smaller ones along that axis.

A splat travels with the Jacobian at its center, as if the flow were straight over its whole
extent. Smaller splats each follow the flow where they are.

Three children stand for a splat of opacity α: the middle one, and one at each side along the
axis, all of ``SHARE`` of its length. Their picture, seen from the side, is one minus the product
of what the three let through. Four of its numbers are made those of the parent: its integral,
its variance along the axis and across it, and its opacity in the middle (the mean is so by
symmetry). Moments are kept by the splits of Feng et al. (2024, arXiv:2403.09143) too, who cut a
Gaussian in two, and shares, places and opacities are fitted to the parent's picture by the
long-axis split of Deng et al. (2024, arXiv:2411.10133).
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache, reduce

import torch
from torch import Tensor

from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.quaternions import to_matrices
from splatmorph.morph.paths import KNOTS, for_each_block
from splatmorph.morph.ramps import DENSEST, STEPS, interpolated, scaled_logits

SHARE = math.sqrt(0.5)
"""Length of a child in its parent's: half the variance is theirs, half is their distance."""

ROUNDS = 3
"""How often children may be split again."""

NEWTON_STEPS = 8
"""Enough for the last digit."""


@torch.no_grad()
def split_stretched(
    gaussians: Gaussians, flow: Flow, direction: int, threshold: float
) -> Gaussians:
    """The splats with those split that the flow stretches on its way to t = ``direction``.

    A splat whose axis becomes longer than ``threshold`` times what it was, and longer than its
    other axes, is split along that axis, and its children again until they are shorter.

    Returns:
        as many splats as before, in their order, the middle children in place of their parents;
        after them the other children.
    """
    limits = threshold * gaussians.scales
    for _ in range(ROUNDS):
        lengths = _longest(gaussians, flow, direction)
        axis = lengths.argmax(1)
        parents = (lengths > limits).take_along_dim(axis[:, None], 1).squeeze(1).nonzero().flatten()
        if not len(parents):
            break
        gaussians = split(gaussians, parents, axis[parents])
        limits = torch.cat([limits, limits[parents], limits[parents]])
    return gaussians


def _longest(gaussians: Gaussians, flow: Flow, direction: int) -> Tensor:
    """(n, 3) the longest that each axis becomes on the way from t = 0 to ``direction``."""
    stops = [direction * k / KNOTS for k in range(1, KNOTS + 1)]
    lengths = gaussians.scales.clone()

    def work_out(block: slice, _: Tensor, jacobians: Tensor) -> None:
        axes = to_matrices(gaussians.quats[block])
        stretches = (jacobians @ axes).square().sum(2).amax(0).sqrt()
        lengths[block] *= stretches.clamp_min(1)

    for_each_block(work_out, flow, gaussians.means, stops)
    return lengths


def split(gaussians: Gaussians, parents: Tensor, axis: Tensor, share: float = SHARE) -> Gaussians:
    """``gaussians`` with the ``parents`` (m,) split along their ``axis`` (m,), 0 to 2.

    ``share`` is the length of a child in its parent's. The middle children take their parents'
    places; the m on one side and then the m on the other follow all others.
    """
    whole = gaussians.select(parents)
    middle, side, distance, width = interpolated(
        _children(share), whole.opacities.clamp_max(DENSEST)
    )
    along = torch.nn.functional.one_hot(axis, 3).bool()
    narrower = torch.where(along, math.log(share), width.log()[:, None])
    direction = to_matrices(whole.quats)[torch.arange(len(axis)), :, axis]
    offset = (distance * whole.scales[along])[:, None] * direction

    smaller = replace(whole, log_scales=whole.log_scales + narrower)
    faded = [scaled_logits(whole.opacity_logits, factor.log()) for factor in (middle, side)]
    sides = [
        replace(smaller, means=whole.means + step, opacity_logits=faded[1])
        for step in (offset, -offset)
    ]
    kept = replace(
        gaussians,
        log_scales=gaussians.log_scales.index_copy(0, parents, smaller.log_scales),
        opacity_logits=gaussians.opacity_logits.index_copy(0, parents, faded[0]),
    )
    return reduce(Gaussians.union, [kept, *sides])


@lru_cache
def _children(share: float) -> Tensor:
    """What three children are for α = 0 … DENSEST: (STEPS + 1, 4) float64.

    By row the middle one's opacity and each side one's in units of α, the distance to the side
    in lengths of the parent, and their width across the axis in the parent's.
    """
    alpha = torch.linspace(0, DENSEST, STEPS + 1, dtype=torch.float64).clamp_min(1e-6)
    children = alpha.new_tensor([0.8, 0.3, 1.1, 1.0]).expand(len(alpha), 4)
    # Newton's method. What is analytic has its slope in the imaginary part of a tiny step.
    steps = 1e-30j * torch.eye(4, dtype=torch.float64)
    for _ in range(NEWTON_STEPS):
        slopes = _excess(children[:, None] + steps, alpha[:, None], share).imag.mT / 1e-30
        children = children - torch.linalg.solve(slopes, _excess(children, alpha, share))
    return children


def _excess(children: Tensor, alpha: Tensor, share: float) -> Tensor:
    """By how much integral, both variances and peak of the children's picture exceed α's.

    (..., 4) and (...) -> (..., 4). 1 - (1 - A)(1 - B)(1 - C) is a sum of Gaussians: products of m
    of width k have the width k/√m, the mean of their means, and e to minus their spread over 2k².
    """
    middle, side, distance, width = children.unbind(-1)
    middle, side, variance = alpha * middle, alpha * side, share**2
    far, near, middling = ((-(distance**2) / (c * variance)).exp() for c in (1, 4, 2))
    # Of each product its amplitude (signs alternate), squared mean and number of factors.
    amplitudes = torch.stack(
        [middle, 2 * side, -2 * middle * side * near, -(side**2) * far, middle * side**2 * far], -1
    )
    places = distance[..., None] ** 2 * alpha.new_tensor([0, 1, 0.25, 0, 0])
    counts = alpha.new_tensor([1, 1, 2, 2, 3])
    mass = share * width * (amplitudes / counts).sum(-1)
    along = share * width * (amplitudes / counts * (variance / counts + places)).sum(-1)
    across = share * width**3 * (amplitudes / counts**2).sum(-1)
    peak = 1 - (1 - middle) * (1 - side * middling) ** 2
    return torch.stack([mass, along, across, peak], -1) / alpha[..., None] - 1
