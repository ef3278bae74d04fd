"""The similarity that lies between two sets of points, a few of which may be misplaced."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from splatmorph.errors import LandmarkError
from splatmorph.geometry.similarity import Similarity
from splatmorph.steady import one_thread

SUBSETS = 300
"""Smallest sets of pairs that a robust estimate begins from."""
ENOUGH_TO_DOUBT = 8
"""Pairs from which a few can be told to be misplaced: fewer are all believed."""
MOST_SCORED = 500
"""Pairs by which those beginnings are judged."""
TRIMMED = 0.25
"""The part of the pairs that may be misplaced."""
STANDS_OUT = 7.0
"""A pair that is missed by this many times the median is left out of an estimate."""
ROUNDS = 20
EXACT = 1e-7
"""What is met to this part of the set's size is met; beyond it lies the rounding of files."""
LINE = 1e-7
"""Points whose second extent is below this part of their first lie on a line."""
MIRRORED = 0.25
"""A mirror image that is missed by less than this part of what the best similarity misses …"""
NOT_MET = 0.03
"""… is what the target is, where that misses by more than this part of the set's size."""


@one_thread()
def similarity_between(p: Tensor, q: Tensor) -> Similarity:
    """The similarity that takes points p closest to their partners q, (k, dim) each.

    Rotation and shift are those of least squares (Umeyama 1991), the scale is the ratio of the
    sets' spreads, so that swapping the sets gives the inverse. Pairs that stand out from the
    others' similarity, a quarter at most, are left out (least trimmed squares, Rousseeuw and Van
    Driessen 2006). Points on a line are turned by the least angle that does.

    Raises:
        LandmarkError: either set lies in one point, or one is the mirror image of the other.
    """
    p, q = p.detach().cpu().double(), q.detach().cpu().double()
    for side, points in (("source", p), ("target", q)):
        if not len(points) or not (points - points[0]).any():
            raise LandmarkError(
                f"all landmarks of the {side} lie in one point, expected points on an object"
            )
    found = _robust(p, q)
    _refuse_mirrored(p, q, found)
    return found


def _robust(p: Tensor, q: Tensor) -> Similarity:
    """Least trimmed squares, then plain least squares over all that doesn't stand out."""
    whole = _closest(p, q)
    if len(p) < ENOUGH_TO_DOUBT:
        return whole
    kept = math.ceil((1 - TRIMMED) * len(p))
    found = min((whole, _from_few(p, q)), key=lambda one: _trimmed(_misses(one, p, q), kept))
    for choose in (_nearest, _standing_in):
        before = torch.zeros(len(p), dtype=torch.bool)
        for _ in range(ROUNDS):
            trusted = choose(_misses(found, p, q), kept, q)
            if torch.equal(trusted, before):
                break
            found, before = _closest(p[trusted], q[trusted]), trusted
    return found


def _from_few(p: Tensor, q: Tensor) -> Similarity:
    """The best, over all pairs, of the similarities of as few as determine one."""
    generator = torch.Generator().manual_seed(0)
    weights = torch.ones(SUBSETS, min(len(p), MOST_SCORED))
    # Evenly through the set where it is large: these only begin an estimate over all of it.
    seen = torch.linspace(0, len(p) - 1, weights.shape[1]).long()
    p, q = p[seen], q[seen]
    few = torch.multinomial(weights, p.shape[1] + 1, generator=generator)
    rotation, scale, shift = _least_squares(p[few], q[few])
    moved = scale[:, None, None] * (p @ rotation.mT) + shift[:, None]
    misses = (moved - q).norm(dim=2)
    best = int(_trimmed(misses, math.ceil((1 - TRIMMED) * len(p))).argmin())
    return Similarity(rotation[best], float(scale[best]), shift[best])


def _trimmed(misses: Tensor, kept: int) -> Tensor:
    """Sum of the ``kept`` smallest squares, (..., k) -> (...)."""
    return misses.square().sort(dim=-1).values[..., :kept].sum(-1)


def _nearest(misses: Tensor, kept: int, _: Tensor) -> Tensor:
    trusted = torch.zeros_like(misses, dtype=torch.bool)
    trusted[misses.argsort()[:kept]] = True
    return trusted


def _standing_in(misses: Tensor, kept: int, q: Tensor) -> Tensor:
    size = float((q - q.median(0).values).norm(dim=1).median())
    trusted = misses <= max(STANDS_OUT * float(misses.median()), EXACT * size)
    return trusted if int(trusted.sum()) >= kept else _nearest(misses, kept, q)


def _misses(similarity: Similarity, p: Tensor, q: Tensor) -> Tensor:
    return (similarity(p) - q).norm(dim=1)


def _closest(p: Tensor, q: Tensor) -> Similarity:
    """The least-squares similarity over all pairs, of all such the one that turns least."""
    rotation, scale, shift = _least_squares(p, q)
    from_p, from_q = p - p.mean(0), q - q.mean(0)
    _, extents, along = torch.linalg.svd(from_p, full_matrices=False)
    if p.shape[1] == 3 and float(extents[1]) <= LINE * float(extents[0]):
        image = from_q.T @ (from_p @ along[0])
        rotation = _least_turn(along[0], image / image.norm().clamp_min(1e-300))
        shift = q.mean(0) - scale * rotation @ p.mean(0)
    return Similarity(rotation, float(scale), shift)


def _least_squares(p: Tensor, q: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """R, s, t of Umeyama's similarity with the symmetric scale, for sets (..., k, dim)."""
    middle_p, middle_q = p.mean(-2), q.mean(-2)
    from_p, from_q = p - middle_p[..., None, :], q - middle_q[..., None, :]
    spread_p, spread_q = (each.flatten(-2).norm(dim=-1) for each in (from_p, from_q))
    scale = torch.where((spread_p > 0) & (spread_q > 0), spread_q / spread_p, 1.0)
    size = (spread_p * spread_q).clamp_min(1e-300)[..., None, None]
    left, _, right = torch.linalg.svd(from_q.mT @ from_p / size)
    handed = torch.ones_like(middle_p)
    handed[..., -1] = torch.where(torch.linalg.det(left @ right) < 0, -1.0, 1.0)
    rotation = (left * handed[..., None, :]) @ right
    shift = middle_q - scale[..., None] * (rotation @ middle_p[..., None])[..., 0]
    return rotation, scale, shift


def _least_turn(a: Tensor, b: Tensor) -> Tensor:
    """The rotation by the least angle that takes unit vector a to b in space, or to -b."""
    cosine, normal = a @ b, torch.linalg.cross(a, b)
    if float(normal.norm()) < 1e-12:
        if float(cosine) > 0:
            return torch.eye(3).double()
        normal = torch.linalg.cross(a, torch.eye(3).double()[int(a.abs().argmin())])
        normal = normal / normal.norm()
        return 2 * torch.outer(normal, normal) - torch.eye(3).double()
    x, y, z = normal.tolist()
    skew = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    return torch.eye(3).double() + skew + skew @ skew / (1 + cosine)


def _refuse_mirrored(p: Tensor, q: Tensor, found: Similarity) -> None:
    if len(p) <= p.shape[1]:
        return
    size = float((q - q.median(0).values).norm(dim=1).median())
    missed = float(_misses(found, p, q).median())
    if missed <= NOT_MET * size:
        return
    flipped = p.clone()
    flipped[:, 0] *= -1
    if float(_misses(_robust(flipped, q), flipped, q).median()) < MIRRORED * missed:
        raise LandmarkError(
            "the target's landmarks are the mirror image of the source's (left and right "
            "exchanged in the names, or an axis of one file turned round), expected the same "
            "handedness: exchange the names, or mirror one of the inputs"
        )
