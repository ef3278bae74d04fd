"""Colour: each half learns what the other shows in its place.

Where the two surfaces coincide, the splats of one take on the difference between the pictures of
the other and their own, read back by their shares of the pixels; rendered again, what is still
missing is read back too (the method of simultaneous iterations, SIRT, of tomography).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import SH0
from splatmorph.morph.agreement.neighbours import Neighbours
from splatmorph.morph.agreement.views import Picture, View, blurred
from splatmorph.rendering import renderer_arrays

FAR = 0.06
"""Of the radius: surfaces further apart have nothing to do with each other."""

COARSE = 1.0
"""Pixels of the coarse views: finer detail of the difference stays a splat's own."""

ROUNDS = 3
"""Rounds of reading back."""

PUSH = 1.5
"""How much of what is missing is added a round; iterations of this kind converge below 2."""

UNSURE = 1.0
"""Pixels of which a splat must be seen to be trusted more than its neighbours."""

ALONE = 0.1
"""The part of what is seen of a splat that must coincide with the other for half of the change."""


@dataclass(frozen=True)
class Goal:
    """What a part should look like in one view."""

    rgb: Tensor
    """(3, h, w)"""
    same: Tensor
    """(h, w) how far it is of the same surface, in [0, 1]."""


def goal(mine: Picture, others: Sequence[Picture], shares: Sequence[float], radius: float) -> Goal:
    """The mixture of ``mine`` and of ``shares`` of the others, where they show the same surface."""
    weights = [
        share * _common(mine, other, radius) for share, other in zip(shares, others, strict=True)
    ]
    total = torch.stack(weights).sum(0)
    change = sum(w * (other.rgb - mine.rgb) for w, other in zip(weights, others, strict=True))
    whole = sum(shares)
    return Goal(mine.rgb + whole * change / total.clamp_min(1e-6), total / whole)


def _common(mine: Picture, other: Picture, radius: float) -> Tensor:
    """How far both show the same surface, (h, w) in [0, 1]."""
    gap = (other.depth - mine.depth) / (FAR * radius)
    both = (other.alpha > 0.5) & (mine.alpha > 0.3)
    return torch.where(both, torch.exp(-0.5 * gap**2), 0)


def change(
    part: Gaussians,
    views: Sequence[View],
    mine: Sequence[Picture],
    goals: Sequence[Goal],
    around: Neighbours,
    tick: Callable[[], None],
) -> tuple[Tensor, Tensor]:
    """The change (n, 3) of RGB that makes ``part`` look like its goals, and its trust (n,).

    Arguments:
        part: the splats at the common shape.
        views: from where, with the pictures of ``part`` as ``mine``.
        around: the neighbours in ``part``.
        tick: called after each round.
    """
    arrays = renderer_arrays(part)
    turns = torch.zeros(2, len(part), 5)
    for k, (view, own, wanted) in enumerate(zip(views, mine, goals, strict=True)):
        whole = torch.ones_like(wanted.same)
        turns[k % 2] += view.gather(arrays, [wanted.same, whole, *_missing(wanted, own)])
    sums = turns.sum(0)
    total, seen = sums[:, :2].unbind(1)
    trust = (total / (total + ALONE * seen + 1e-3))[:, None]
    sure = (total / (total + UNSURE))[:, None]
    changed = torch.zeros(len(part), 3)
    step, times = sums[:, 2:], total
    for done in range(ROUNDS):
        step = step / times.clamp_min(1e-6)[:, None]
        nearby = around.means(step, sure[:, 0])
        changed += PUSH * trust * torch.lerp(nearby, step, sure)
        tick()
        if done + 1 < ROUNDS:
            # Further rounds look from every other side in turn, which tells them as much.
            turn = slice(done % 2, None, 2)
            coloured = renderer_arrays(recoloured(part, changed))
            step, times = torch.zeros(len(part), 3), turns[done % 2, :, 0]
            for view, wanted in zip(views[turn], goals[turn], strict=True):
                step += view.gather(arrays, _missing(wanted, view.picture(coloured)))
    return changed, trust[:, 0]


def _missing(wanted: Goal, shown: Picture) -> Sequence[Tensor]:
    """What a picture lacks of what is wanted, three of (h, w)."""
    weight = blurred(wanted.same[None], COARSE).clamp_min(1e-4)
    missing = blurred((wanted.rgb - shown.rgb) * wanted.same, COARSE) / weight * wanted.same
    return missing.unbind(0)


def recoloured(part: Gaussians, change: Tensor) -> Gaussians:
    """``part`` with its RGB changed (n, 3), seen from anywhere."""
    sh = part.sh.clone()
    sh[:, 0] += change.to(sh) / SH0
    return replace(part, sh=sh)


def view_dependence(
    part: Gaussians, others: Sequence[Gaussians], shares: Sequence[float], around: Neighbours
) -> Tensor:
    """The change (n, k, 3) of the bands from degree 1 on towards those of the others nearby."""
    own = around.means(part.sh[:, 1:].flatten(1))
    moved = torch.zeros_like(own)
    for other, share in zip(others, shares, strict=True):
        theirs = Neighbours(other, part.means).means(other.sh[:, 1:].flatten(1))
        moved += share * (theirs - own)
    return moved.reshape(len(moved), -1, 3)
