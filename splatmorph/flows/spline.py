"""The spline field: the velocity that bends least between given values."""

from __future__ import annotations

from itertools import combinations
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

CHUNK = 1 << 20
"""Largest number of (point, center) pairs held at once."""


class SplineField(nn.Module):
    """v(u) = Σ_j k(|u - c_j|) w_j + a + B u, a polyharmonic spline with its affine part.

    Among all fields with the same values at the centers it has the least second-order
    (thin-plate) energy: k(r) = -r in space, r² log r in the plane. The cusp that k leaves in the
    gradient at a center is rounded off by r → √(r² + δ²) with ``rounding`` δ in frame units: far
    below the size of a splat, and enough for Runge-Kutta to keep its order.

    With no centers it is an affine field.
    """

    name: ClassVar[str] = "spline"
    centers: Tensor
    weights: Tensor
    affine: Tensor

    def __init__(self, dim: int, *, centers: int = 0, rounding: float = 1e-2) -> None:
        super().__init__()
        self.dim = dim
        self.rounding = rounding
        self.register_buffer("centers", torch.zeros(centers, dim, dtype=torch.float64))
        self.register_buffer("weights", torch.zeros(centers, dim, dtype=torch.float64))
        self.register_buffer("affine", torch.zeros(dim + 1, dim, dtype=torch.float64))

    def options(self) -> dict[str, Any]:
        """The arguments that rebuild this field."""
        return {"centers": len(self.centers), "rounding": self.rounding}

    def set(self, centers: Tensor, weights: Tensor, affine: Tensor) -> None:
        """Replace centers (k, dim), weights (k, dim) and affine part (1 + dim, dim)."""
        self.centers, self.weights, self.affine = (
            value.detach().to(self.affine).clone(memory_format=torch.contiguous_format)
            for value in (centers, weights, affine)
        )

    def forward(self, u: Tensor) -> Tensor:
        """v: (m, dim) -> (m, dim)."""
        return torch.cat([self._value(part) for part in self._parts(u)])

    def jacobian(self, u: Tensor) -> Tensor:
        """∂v/∂u: (m, dim) -> (m, dim, dim)."""
        return torch.cat([self._jacobian(part) for part in self._parts(u)])

    def hessian(self, u: Tensor) -> Tensor:
        """∂²v/∂u²: (m, dim) -> (m, dim, dim, dim), the component of v first."""
        return torch.cat([self._hessian(part) for part in self._parts(u)])

    def _parts(self, u: Tensor) -> tuple[Tensor, ...]:
        return u.split(max(1, CHUNK // max(1, len(self.centers))))

    def _value(self, u: Tensor) -> Tensor:
        affine = self.affine.to(u)
        straight = torch.addmm(affine[0], u, affine[1:])
        if not len(self.centers):
            return straight
        return torch.addmm(straight, self.kernel(u, self.centers.to(u)), self.weights.to(u))

    def _jacobian(self, u: Tensor) -> Tensor:
        # Σ k'/ρ (u - c)_j w_i, multiplied out so that it is one matrix product.
        centers, weights = self.centers.to(u), self.weights.to(u)
        outer = (weights[:, :, None] * centers[:, None, :]).flatten(1)
        first, _ = self._slopes(u)
        summed = first @ torch.cat([weights, outer], dim=1)
        bent = summed[:, : self.dim, None] * u[:, None, :]
        return bent - summed[:, self.dim :].unflatten(1, (self.dim, self.dim)) + self._slope(u)

    def _hessian(self, u: Tensor) -> Tensor:
        weights = self.weights.to(u)
        offsets = u[:, None] - self.centers.to(u)
        first, second = self._slopes(u)
        curved = torch.einsum("mk,mkj,mkl,ki->mijl", second, offsets, offsets, weights)
        return curved + (first @ weights)[:, :, None, None] * torch.eye(self.dim).to(u)

    def _slope(self, u: Tensor) -> Tensor:
        return self.affine.to(u)[1:].T

    def kernel(self, a: Tensor, b: Tensor) -> Tensor:
        """k(√(|a_i - b_j|² + δ²)): (m, dim), (k, dim) -> (m, k)."""
        rho = self._distances(a, b)
        return -rho if self.dim == 3 else rho.square() * rho.log()

    def _distances(self, a: Tensor, b: Tensor) -> Tensor:
        # δ is one more coordinate by which all of a lies beside all of b.
        lifted = torch.cat([a, torch.full_like(a[:, :1], self.rounding)], dim=1)
        flat = torch.cat([b, torch.zeros_like(b[:, :1])], dim=1)
        return torch.cdist(lifted, flat, compute_mode="donot_use_mm_for_euclid_dist")

    def _slopes(self, u: Tensor) -> tuple[Tensor, Tensor]:
        # With offset d: ∇k = first · d and ∇∇k = first · I + second · d dᵀ.
        rho = self._distances(u, self.centers.to(u))
        if self.dim == 3:
            inverse = rho.reciprocal()
            return -inverse, inverse**3
        return 1 + 2 * rho.log(), 2 / rho.square()


class SplineInterpolant:
    """The spline fields on fixed centers, as a function of their values there.

    The linear system is factorised once. ``smoothing`` λ ≥ 0 trades values for bending: with
    λ > 0 the field minimises Σ|v(c_i) - y_i|² + λ · energy, at 0 it interpolates.

    The polynomial part is affine, restricted to the directions that the centers span, so that
    coplanar or very few centers have a solution too: the field is then constant across the
    others. With ``shear`` only what moves the centers like a similarity is free, and the rest of
    the linear part costs as if drawn with that variance: centers that leave it open, being few or
    close to a plane, then don't send it anywhere.
    """

    def __init__(
        self, field: SplineField, centers: Tensor, smoothing: float, shear: float | None = None
    ) -> None:
        self.field = field
        self.centers = centers
        self.shear = shear
        count = len(centers)
        self.mean = centers.mean(0)
        self.spread = centers - self.mean
        matrix = field.kernel(centers, centers)
        polynomials = torch.ones_like(self.spread[:, :1])
        if shear is None:
            _, singular, axes = torch.linalg.svd(self.spread, full_matrices=False)
            self.axes = axes[singular > 1e-6 * singular.max().clamp_min(1e-300)]
            polynomials = torch.cat([polynomials, self.spread @ self.axes.T], dim=1)
        else:
            matrix = matrix + shear * self.spread @ self.spread.T
        extra = polynomials.shape[1]
        system = centers.new_zeros(count + extra, count + extra)
        # A kernel matrix of clustered points is close to singular; the 1e-12 is rounding.
        system[:count, :count] = matrix + (smoothing + 1e-12) * torch.eye(count).to(centers)
        system[:count, count:] = polynomials
        system[count:, :count] = polynomials.T
        self.factors = torch.linalg.lu_factor(system)

    def set_values(self, values: Tensor) -> None:
        """Give the field the values (k, dim) at the centers."""
        count = len(self.centers)
        if self.shear is None:
            solution = self._solved(values)
            slope = self.axes.T @ solution[count + 1 :]
        else:
            free = similar_slope(self.spread, values)
            solution = self._solved(values - self.spread @ free)
            slope = free + self.shear * self.spread.T @ solution[:count]
        constant = solution[count] - self.mean @ slope
        self.field.set(self.centers, solution[:count], torch.cat([constant[None], slope]))

    def _solved(self, values: Tensor) -> Tensor:
        extra = len(self.factors[1]) - len(values)
        padded = torch.cat([values, values.new_zeros(extra, values.shape[1])])
        return torch.linalg.lu_solve(*self.factors, padded)


def similar_slope(x: Tensor, y: Tensor) -> Tensor:
    """The slope B (dim, dim) of the rotation and scaling whose y ≈ x B, x (k, dim) centred.

    By the pseudo-inverse: points on a line leave the turn about it open, and so it is none.
    """
    dim = x.shape[1]
    basis = [torch.eye(dim)]
    for i, j in combinations(range(dim), 2):
        turn = torch.zeros(dim, dim)
        turn[i, j], turn[j, i] = 1.0, -1.0
        basis.append(turn)
    slopes = torch.stack(basis).to(x)
    moves = torch.stack([(x @ slope).flatten() for slope in slopes], dim=1)
    weights = torch.linalg.pinv(moves, rtol=1e-6) @ (y - y.mean(0)).flatten()
    return torch.einsum("n,nij->ij", weights, slopes)
