"""Forward differentiation: value, first and second derivatives pushed together (paper, app. A).

A function is written as a chain of linear maps, activations, products and affine flows, each of
which maps a triplet ⟨z, ż, z̈⟩ to a triplet. The derivatives are kept one direction after the
other in front, so that a linear map is one matrix product for each of the three.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations_with_replacement

import torch
from torch import Tensor

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
    second: Tensor | None = None
    """(len(pairs), m, k) second derivative of z along each pair of directions"""
    pairs: Pairs = ()
    """The pairs (i, j) of directions, i ≤ j, that ``second`` holds."""

    @staticmethod
    def seed(x: Tensor, order: int = 2) -> Jet:
        """x itself, (m, n), with all first (and at order 2 all second) derivatives."""
        n = x.shape[1]
        directions = torch.eye(n, dtype=x.dtype, device=x.device)[:, None].expand(n, len(x), n)
        every = tuple(combinations_with_replacement(range(n), 2))
        return Jet.along(x, directions, every if order == 2 else ())

    @staticmethod
    def along(x: Tensor, directions: Tensor, pairs: Pairs = ()) -> Jet:
        """x itself, (m, n), with derivatives along ``directions`` (d, m, n) and their ``pairs``."""
        second = x.new_zeros(len(pairs), *x.shape) if pairs else None
        return Jet(x, directions, second, pairs)

    def linear(self, weight: Tensor, bias: Tensor | None = None) -> Jet:
        """⟨Wz + b, Wż, Wz̈⟩ for ``weight`` (k', k) and ``bias`` (k',)."""
        moved = self.value @ weight.T
        return Jet(
            moved if bias is None else moved + bias,
            self.first @ weight.T,
            None if self.second is None else self.second @ weight.T,
            self.pairs,
        )

    def activate(self, activation: Activation) -> Jet:
        """⟨g(z), g'(z) ż, g'(z) z̈ + g''(z) ż żᵀ⟩ for an elementwise g."""
        if self.second is None:
            g, slope = activation(self.value, 1)
            return Jet(g, slope * self.first)
        g, slope, bend = activation(self.value, 2)
        crossed = torch.stack([self.first[i] * self.first[j] for i, j in self.pairs])
        return Jet(g, slope * self.first, slope * self.second + bend * crossed, self.pairs)

    def __add__(self, other: Jet) -> Jet:
        return Jet(
            self.value + other.value,
            self.first + other.first,
            None if self.second is None or other.second is None else self.second + other.second,
            self.pairs,
        )

    def __mul__(self, other: Jet) -> Jet:
        """The elementwise product, by Leibniz' rule."""
        first = self.first * other.value + self.value * other.first
        if self.second is None or other.second is None:
            return Jet(self.value * other.value, first)
        a, b = self.first, other.first
        crossed = torch.stack([a[i] * b[j] + a[j] * b[i] for i, j in self.pairs])
        second = self.second * other.value + self.value * other.second + crossed
        return Jet(self.value * other.value, first, second, self.pairs)

    def columns(self, index: list[int]) -> Jet:
        """Some of the k components."""
        return Jet(
            self.value[..., index],
            self.first[..., index],
            None if self.second is None else self.second[..., index],
            self.pairs,
        )

    @staticmethod
    def join(parts: list[Jet]) -> Jet:
        """Components of several jets beside each other."""
        seconds = [part.second for part in parts if part.second is not None]
        return Jet(
            torch.cat([part.value for part in parts], -1),
            torch.cat([part.first for part in parts], -1),
            torch.cat(seconds, -1) if seconds else None,
            parts[0].pairs,
        )

    def jacobian(self) -> Tensor:
        """∂z/∂x, (m, k, d)."""
        return self.first.permute(1, 2, 0)

    def hessian(self) -> Tensor:
        """∂²z/∂x², (m, k, d, d), for a jet that holds every pair."""
        assert self.second is not None
        d, m, k = self.first.shape
        full = self.value.new_empty(m, k, d, d)
        for (i, j), values in zip(self.pairs, self.second, strict=True):
            full[:, :, i, j] = full[:, :, j, i] = values
        return full
