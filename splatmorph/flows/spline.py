"""The spline field: the velocity that bends least between given values."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

CHUNK = 1 << 20
"""Largest number of (point, center) pairs held at once."""


class SplineField(nn.Module):
    """v(u) = Σ_j k(|u - c_j|) w_j + a + B u, a polyharmonic spline with its affine part.

    Among all fields with the same values at the centers it has the least second-order
    (thin-plate) energy: k(r) = -r in space, r² log r in the plane. The cusp that k leaves in the
    gradient at a center is rounded off by r → √(r² + δ²) with ``rounding`` δ in frame units.

    With no centers it is an affine field.
    """

    centers: Tensor
    weights: Tensor
    affine: Tensor

    def __init__(self, dim: int, *, centers: int = 0, rounding: float = 1e-3) -> None:
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
            value.detach().to(self.affine) for value in (centers, weights, affine)
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
        kernel = self.kernel(squared_distances(u, self.centers.to(u)))
        affine = self.affine.to(u)
        return torch.addmm(affine[0], u, affine[1:]) + kernel @ self.weights.to(u)

    def _jacobian(self, u: Tensor) -> Tensor:
        offsets = u[:, None] - self.centers.to(u)
        first, _ = self._slopes(offsets.square().sum(-1))
        bent = torch.einsum("mk,mkj,ki->mij", first, offsets, self.weights.to(u))
        return bent + self.affine.to(u)[1:].T

    def _hessian(self, u: Tensor) -> Tensor:
        offsets = u[:, None] - self.centers.to(u)
        first, second = self._slopes(offsets.square().sum(-1))
        weights = self.weights.to(u)
        curved = torch.einsum("mk,mkj,mkl,ki->mijl", second, offsets, offsets, weights)
        return curved + torch.einsum("mk,ki,jl->mijl", first, weights, torch.eye(self.dim).to(u))

    def kernel(self, squared: Tensor) -> Tensor:
        """k as a function of r², any shape."""
        rounded = squared + self.rounding**2
        return -rounded.sqrt() if self.dim == 3 else 0.5 * rounded * rounded.log()

    def _slopes(self, squared: Tensor) -> tuple[Tensor, Tensor]:
        # With s = r² + δ² and offset d: ∇k = first·d, ∇∇k = first·I + second·d dᵀ.
        rounded = squared + self.rounding**2
        if self.dim == 3:
            first = -rounded.rsqrt()
            return first, -first / rounded
        return 1 + rounded.log(), 2 / rounded


def squared_distances(a: Tensor, b: Tensor) -> Tensor:
    """|a_i - b_j|²: (m, dim), (k, dim) -> (m, k), without the cancellation of a² - 2ab + b²."""
    return sum(((a[:, i, None] - b[None, :, i]).square() for i in range(a.shape[1])), 0 * a[:, :1])


class SplineInterpolant:
    """The spline fields on fixed centers, as a function of their values there.

    The linear system is factorised once. ``smoothing`` λ ≥ 0 trades values for bending: with
    λ > 0 the field minimises Σ|v(c_i) - y_i|² + λ · energy, at 0 it interpolates.

    The polynomial part is restricted to the directions that the centers span, so that coplanar
    or very few centers have a solution too: the field is then constant across the others.
    """

    def __init__(self, field: SplineField, centers: Tensor, smoothing: float) -> None:
        self.field = field
        self.centers = centers
        count, dim = centers.shape
        self.mean = centers.mean(0)
        spread = centers - self.mean
        _, singular, axes = torch.linalg.svd(spread, full_matrices=False)
        self.axes = axes[singular > 1e-6 * singular.max().clamp_min(1e-300)]
        polynomials = torch.cat([torch.ones_like(spread[:, :1]), spread @ self.axes.T], dim=1)
        extra = polynomials.shape[1]
        system = centers.new_zeros(count + extra, count + extra)
        system[:count, :count] = field.kernel(squared_distances(centers, centers))
        system[:count, :count].diagonal().add_(smoothing)
        system[:count, count:] = polynomials
        system[count:, :count] = polynomials.T
        # A kernel matrix of clustered points is close to singular; this much is rounding.
        system[:count, :count].diagonal().add_(1e-12)
        self.factors = torch.linalg.lu_factor(system)

    def set_values(self, values: Tensor) -> None:
        """Give the field the values (k, dim) at the centers."""
        count, dim = self.centers.shape
        padded = torch.cat([values, values.new_zeros(1 + len(self.axes), dim)])
        solution = torch.linalg.lu_solve(*self.factors, padded)
        slope = self.axes.T @ solution[count + 1 :]
        constant = solution[count] - self.mean @ slope
        self.field.set(self.centers, solution[:count], torch.cat([constant[None], slope]))
