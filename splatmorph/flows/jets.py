"""Forward differentiation: value, first and second derivatives pushed together (paper, app. A).

A function is written as a chain of linear maps, activations, products and affine flows, each of
which maps a triplet ⟨z, ż, z̈⟩ to a triplet. The derivatives are kept one direction after the
other in front, so that a linear map is one matrix product for each of the three.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from itertools import combinations_with_replacement

import torch
from torch import Tensor

FEW = 3
"""Columns of a matrix that are summed one by one."""

Pairs = tuple[tuple[int, int], ...]

Activation = Callable[[Tensor, int], tuple[Tensor, ...]]
"""(z, order) -> g(z), g'(z), … up to the order: elementwise."""


@dataclass(frozen=True)
class Jet:
    """z (m, k) as a function of x, with its derivatives along d directions in x."""

    value: Tensor
    """(m, k) z"""
    first: Tensor
    """(d, m, k) derivative of z along each direction"""
    pairs: Pairs = ()
    """The pairs (i, j) of directions, i ≤ j, whose second derivatives are kept."""
    second: Tensor | None = None
    """(len(pairs), m, k) second derivative along each pair; None: zero."""

    @staticmethod
    def seed(x: Tensor, order: int = 2) -> Jet:
        """x itself, (m, n), with all first (and at order 2 all second) derivatives."""
        n = x.shape[1]
        directions = torch.eye(n, dtype=x.dtype, device=x.device)[:, None].expand(n, len(x), n)
        every = tuple(combinations_with_replacement(range(n), 2))
        return Jet(x, directions, every if order == 2 else ())

    def linear(self, weight: Tensor, bias: Tensor | None = None) -> Jet:
        """⟨Wz + b, Wż, Wz̈⟩ for ``weight`` (k', k) and ``bias`` (k',)."""
        moved = _times(self.value, weight)
        if bias is not None:
            moved = moved + bias
        second = None if self.second is None else _times(self.second, weight)
        return Jet(moved, _times(self.first, weight), self.pairs, second)

    def activate(self, activation: Activation) -> Jet:
        """⟨g(z), g'(z) ż, g'(z) z̈ + g''(z) ż żᵀ⟩ for an elementwise g."""
        if not self.pairs:
            g, slope = activation(self.value, 1)
            return Jet(g, slope * self.first)
        g, slope, bend = activation(self.value, 2)
        bent = bend * self.first
        second = torch.stack([bent[i] * self.first[j] for i, j in self.pairs])
        if self.second is not None:
            second = torch.addcmul(second, slope, self.second)
        return Jet(g, slope * self.first, self.pairs, second)

    def then(self, outer: Jet) -> Jet:
        """The chain rule: ``outer`` holds y and all its derivatives in z, z this jet's value."""
        first = torch.einsum("imo,dmi->dmo", outer.first, self.first)
        if not self.pairs:
            return Jet(outer.value, first)
        left, right = (self.first[list(side)] for side in zip(*self.pairs, strict=True))
        second = torch.einsum("moij,pmi,pmj->pmo", outer.hessian(), left, right)
        if self.second is not None:
            second = second + torch.einsum("imo,pmi->pmo", outer.first, self.second)
        return Jet(outer.value, first, self.pairs, second)

    def __add__(self, other: Jet) -> Jet:
        second = self.second if other.second is None else other.second
        if self.second is not None and other.second is not None:
            second = self.second + other.second
        return Jet(self.value + other.value, self.first + other.first, self.pairs, second)

    def __mul__(self, other: Jet) -> Jet:
        """The elementwise product, by Leibniz' rule."""
        first = self.first * other.value + self.value * other.first
        if not self.pairs:
            return Jet(self.value * other.value, first)
        a, b = self.first, other.first
        second = torch.stack([a[i] * b[j] + a[j] * b[i] for i, j in self.pairs])
        for bent, factor in ((self.second, other.value), (other.second, self.value)):
            if bent is not None:
                second = second + bent * factor
        return Jet(self.value * other.value, first, self.pairs, second)

    def columns(self, index: list[int]) -> Jet:
        """Some of the k components."""
        second = None if self.second is None else self.second[..., index]
        return Jet(self.value[..., index], self.first[..., index], self.pairs, second)

    @staticmethod
    def join(a: Jet, b: Jet) -> Jet:
        """The components of two jets beside each other."""
        second = None
        if a.second is not None or b.second is not None:
            second = torch.cat([a._bent(), b._bent()], -1)
        return Jet(
            torch.cat([a.value, b.value], -1),
            torch.cat([a.first, b.first], -1),
            a.pairs,
            second,
        )

    def _bent(self) -> Tensor:
        if self.second is not None:
            return self.second
        return self.value.new_zeros(len(self.pairs), *self.value.shape)

    def jacobian(self) -> Tensor:
        """∂z/∂x, (m, k, d)."""
        return self.first.permute(1, 2, 0)

    def hessian(self) -> Tensor:
        """∂²z/∂x², (m, k, d, d), for a jet that holds every pair."""
        d = len(self.first)
        where = {pair: place for place, pair in enumerate(self.pairs)}
        order = [where[min(i, j), max(i, j)] for i in range(d) for j in range(d)]
        bent = self._bent().unbind()
        return torch.stack([bent[k] for k in order], -1).unflatten(2, (d, d))


def _times(z: Tensor, weight: Tensor) -> Tensor:
    """W z for z (…, k). Few columns are summed: matrix products take longer to wake threads."""
    if weight.shape[1] > FEW:
        return z @ weight.T
    terms = (z[..., k, None] * column for k, column in enumerate(weight.unbind(1)))
    return reduce(torch.add, terms)
