"""What a spline fit can tell from its landmarks alone, in closed form: how far to trust them.

Frame units throughout: x (k, 3) are the midpoints (p + q)/2 and y (k, 3) is q - p. For a
kernel K with constants free, let Z span what is orthogonal to them and ZᵀKZ = U S Uᵀ, V = Z U.
Then for every smoothing λ the weights are w = V (S + λ)⁻¹ Vᵀ y, and with
g_i = Σ_j V_ij² / (S_j + λ) landmark i is missed by w_i / g_i where the others are fitted without
it (leave-one-out, Craven and Wahba 1979; Dubrule 1983).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from splatmorph.fitting.report import SMOOTHING
from splatmorph.flows import SplineField
from splatmorph.flows.spline import similar_slope

LAMBDAS = (SMOOTHING, 6e-4, 2e-3, 6e-3, 2e-2, 6e-2, 0.2, 0.6, 2.0)
SHEARS = (0.03, 0.3, 3.0, 30.0)
"""Prior variances of the linear part beside a similarity, per unit of the frame squared."""
FREE = 1e3
FEW = 20
"""Fewer landmarks leave the linear part open and can't tell noise from shape: their shear is
chosen, and λ stays. More fix the linear part: λ is chosen, and shear is free."""
THIN = 0.05
"""But landmarks whose thinnest extent is this part of their widest leave it open however many."""
MOST = 1000
"""Landmarks that are looked at: the work grows with their cube."""

STIFF = 0.2
"""The smoothing under which suspects are looked for, with the second of ``SHEARS``."""
STANDS_OUT = 7.0
"""Times the median surprise that make a suspect …"""
VISIBLE = 0.02
"""… where it is missed by so much, frame units (1 % of the box), leaving it out: of a dense and
exact set some point always stands out by less."""
FEWEST_KEPT = 8
SUSPECT_SHARE = 0.25


@dataclass(frozen=True)
class Choice:
    """How far a fit trusts its landmarks."""

    smoothing: float
    """λ"""
    shear: float | None
    """Prior variance of the linear part beside a similarity; None where it is free."""
    predicted: float
    """Mean distance by which the landmarks predict one another, each from all others."""


def choose(p: Tensor, q: Tensor) -> Choice:
    """Smoothing and shear for matched landmarks p, q (k, 3), frame coordinates.

    λ leaves the least on evidence only: it is the smallest within one standard error, of the
    paired differences, of the best mean |leave-one-out|. The mean of squares is misled by swaps.
    """
    few = len(p) < FEW
    seen = torch.linspace(0, len(p) - 1, min(len(p), MOST), device=p.device).long()
    x, y = (p[seen] + q[seen]) / 2, (q - p)[seen]
    shears = SHEARS if few or is_thin(x) else (FREE,)
    lambdas = LAMBDAS[:1] if few else LAMBDAS
    tried = []
    for shear in shears:
        regression = Regression(x, y, shear)
        tried.append((torch.stack([regression.left_out(one) for one in lambdas]), shear))
    errors, shear = min(tried, key=lambda one: float(one[0].mean(1).min()))
    scores = errors.mean(1)
    best = int(scores.argmin())
    slack = (errors - errors[best]).std(1) / len(x) ** 0.5
    chosen = int(torch.nonzero(scores <= scores[best] + slack)[0])
    return Choice(lambdas[chosen], None if shear == FREE else shear, float(scores[chosen]))


def is_thin(x: Tensor) -> bool:
    """Whether points (k, 3) lie close to a plane."""
    extents = torch.linalg.svdvals(x - x.mean(0))
    return float(extents[-1]) < THIN * float(extents[0])


def suspects(p: Tensor, q: Tensor) -> list[int]:
    """Which of the matched landmarks p, q (k, dim) the others contradict, the worst first.

    As ``standing_out`` says, ``STANDS_OUT`` times the median and missed visibly; a quarter at most,
    and eight are kept.
    """
    kept = torch.linspace(0, len(p) - 1, min(len(p), MOST), device=p.device).long()
    x, y = (p[kept] + q[kept]) / 2, (q - p)[kept]
    most = min(len(kept) - FEWEST_KEPT, int(SUSPECT_SHARE * len(kept)))
    found = standing_out(x, y, most, smoothing=STIFF, times=STANDS_OUT, missed=VISIBLE)
    return kept[found].tolist()


def standing_out(
    x: Tensor, y: Tensor, most: int, *, smoothing: float, times: float, missed: float
) -> list[int]:
    """Which of the pairs with midpoints x and displacements y (k, dim) stand out, the worst first.

    A pair's surprise is what it is missed by, leaving it out, against how well the others
    determine that place. The worst is left out before the next is looked for, since it spoils its
    neighbours', until there are ``most``, or none is ``times`` the median and ``missed`` so far.
    """
    found: list[int] = []
    if most <= 0:
        return found
    kept = torch.arange(len(x), device=x.device)
    inverse = Regression(x, y, SHEARS[1]).inverse(smoothing)
    while len(found) < most:
        around = x - x.mean(0)
        weights = inverse @ (y - around @ similar_slope(around, y))
        sure = inverse.diagonal().clamp_min(1e-300).sqrt()
        surprise = weights.norm(dim=1) / sure
        worst = int(surprise.argmax())
        stands_out = float(surprise[worst]) >= times * float(surprise.median())
        if not stands_out or float(surprise[worst] / sure[worst]) < missed:
            break
        found.append(int(kept[worst]))
        # The inverse of a system without a row and its column, by that of the whole.
        column = inverse[:, worst]
        inverse = inverse - torch.outer(column, column) / column[worst]
        others = torch.arange(len(kept), device=x.device) != worst
        inverse, kept, x, y = inverse[others][:, others], kept[others], x[others], y[others]
    return found


class Regression:
    """The splines through (x, y) of every λ, a translation, rotation and scale being free."""

    def __init__(self, x: Tensor, y: Tensor, shear: float) -> None:
        x = x - x.mean(0)
        self.y = y - x @ similar_slope(x, y)
        z = torch.linalg.qr(torch.ones_like(x[:, :1]), mode="complete").Q[:, 1:]
        self.s, u = torch.linalg.eigh(z.T @ (SplineField(3).kernel(x, x) + shear * x @ x.T) @ z)
        self.v = z @ u

    def _inverse_spectrum(self, smoothing: float) -> Tensor:
        return 1 / (self.s.clamp_min(1e-12) + smoothing)

    def left_out(self, smoothing: float) -> Tensor:
        """(k,) how far each landmark is missed by the spline of the others."""
        spectrum = self._inverse_spectrum(smoothing)
        weights = self.v @ (spectrum[:, None] * (self.v.T @ self.y))
        return weights.norm(dim=1) / (self.v.square() @ spectrum)

    def inverse(self, smoothing: float) -> Tensor:
        """(k, k) from values to weights."""
        return (self.v * self._inverse_spectrum(smoothing)) @ self.v.T
