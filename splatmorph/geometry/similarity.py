"""Similarities of space and of the plane: the group, and the way through it.

Its one-parameter subgroups S(t) = exp(t log S) are how a morph plays what a rigid motion and a
change of size do, and no flow need do.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from splatmorph.geometry.quaternions import from_matrices


@dataclass(frozen=True, eq=False)
class Similarity:
    """x ↦ s R x + t: a rotation, a scale above 0 and a shift.

    >>> there = Similarity(torch.eye(3), 4.0, torch.zeros(3))
    >>> there.power(0.5).scale
    2.0

    Raises ``ValueError`` where the numbers are no similarity: a programming error.
    """

    rotation: Tensor
    """R, (dim, dim) float64, dim 2 or 3."""
    scale: float
    """s > 0"""
    shift: Tensor
    """t, (dim,) float64, in the units of the side that it maps to."""

    def __post_init__(self) -> None:
        dim = self.shift.shape[0] if self.shift.ndim == 1 else 0
        if dim not in (2, 3) or self.rotation.shape != (dim, dim):
            raise ValueError(f"R is {tuple(self.rotation.shape)}, t {tuple(self.shift.shape)}")
        for name in ("rotation", "shift"):
            object.__setattr__(self, name, getattr(self, name).detach().cpu().double())
        off = float((self.rotation @ self.rotation.T - _unit(dim)).abs().max())
        proper = off < 1e-6 and float(torch.linalg.det(self.rotation)) > 0
        if not proper or not 0 < self.scale < math.inf or not self.shift.isfinite().all():
            raise ValueError("expected a rotation, a finite scale above 0 and a finite shift")

    @staticmethod
    def identity(dim: int = 3) -> Similarity:
        """x ↦ x."""
        return Similarity(torch.eye(dim), 1.0, torch.zeros(dim))

    @property
    def dim(self) -> int:
        """2 for pictures, 3 for splats."""
        return len(self.shift)

    @property
    def is_identity(self) -> bool:
        """Whether it leaves everything where it is, to the last bit."""
        unturned = torch.equal(self.rotation, _unit(self.dim))
        return unturned and self.scale == 1 and not self.shift.any()

    def __call__(self, x: Tensor) -> Tensor:
        """Points (..., dim), worked out in float64 and given back in their own type."""
        moved = self.scale * (x.double() @ self.rotation.T.to(x.device)) + self.shift.to(x.device)
        return moved.to(x.dtype)

    def __matmul__(self, first: Similarity) -> Similarity:
        """This one after ``first``."""
        return Similarity(
            self.rotation @ first.rotation, self.scale * first.scale, self(first.shift)
        )

    def inverse(self) -> Similarity:
        """x ↦ Rᵀ(x - t) / s."""
        back = self.rotation.T
        return Similarity(back, 1 / self.scale, -(back @ self.shift) / self.scale)

    def log(self) -> Tensor:
        """The generator [[log s I + W, u], [0, 0]], (dim + 1, dim + 1), W antisymmetric.

        The angle is at most π; a half turn has two logarithms, of which this is one.
        """
        dim, growth = self.dim, math.log(self.scale)
        angle, plane = _angle_and_plane(self.rotation)
        generator = torch.zeros(dim + 1, dim + 1, dtype=torch.float64)
        generator[:dim, :dim] = growth * _unit(dim) + angle * plane
        generator[:dim, dim] = torch.linalg.solve(_drift(growth, angle, plane), self.shift)
        return generator

    @staticmethod
    def exp(generator: Tensor) -> Similarity:
        """exp of what ``log`` gives, for any angle: with z = log s + iθ and W = θ K, K³ = -K,

        R = 1 + sin θ K + (1 - cos θ) K² and t = ∫₀¹ e^{ρ(log s + W)} dρ u.
        """
        dim = len(generator) - 1
        linear, u = generator[:dim, :dim].double(), generator[:dim, dim].double()
        growth = float(linear.diagonal().mean())
        turning = (linear - linear.T) / 2
        angle = float(turning.norm()) / math.sqrt(2)
        plane = turning / angle if angle > 0 else turning
        square = plane @ plane
        rotation = _unit(dim) + math.sin(angle) * plane
        rotation = rotation + 2 * math.sin(angle / 2) ** 2 * square
        if dim == 2:
            rotation = _unit(2) * math.cos(angle) + math.sin(angle) * plane
        return Similarity(rotation, math.exp(growth), _drift(growth, angle, plane) @ u)

    def power(self, t: float) -> Similarity:
        """S(t) = exp(t log S): the identity at 0, this one itself at 1."""
        if t == 1:
            return self
        return Similarity.exp(t * self.log())

    @property
    def degrees(self) -> float:
        """How far it turns, 0 to 180."""
        return math.degrees(abs(_angle_and_plane(self.rotation)[0]))

    @property
    def axis(self) -> Tensor:
        """(3,) what it turns about, by the right hand; zero where it doesn't turn. In 3D only."""
        plane = _angle_and_plane(self.rotation)[1]
        return torch.stack([plane[2, 1], plane[0, 2], plane[1, 0]])

    def to_dict(self) -> dict[str, Any]:
        """In JSON's types."""
        return {
            "rotation": self.rotation.tolist(),
            "scale": self.scale,
            "shift": self.shift.tolist(),
        }

    @staticmethod
    def from_dict(stored: Mapping[str, Any]) -> Similarity:
        """What ``to_dict`` gave. Raises ``ValueError``, ``TypeError`` or ``KeyError``."""
        return Similarity(
            torch.tensor(stored["rotation"], dtype=torch.float64),
            float(stored["scale"]),
            torch.tensor(stored["shift"], dtype=torch.float64),
        )


def _angle_and_plane(rotation: Tensor) -> tuple[float, Tensor]:
    """θ and K with R = exp(θ K): θ in [0, π] in space and (-π, π] in the plane; K of unit size."""
    if len(rotation) == 2:
        plane = torch.tensor([[0.0, -1.0], [1.0, 0.0]], dtype=torch.float64)
        sine = float(rotation[1, 0] - rotation[0, 1])
        return math.atan2(sine, float(rotation[0, 0] + rotation[1, 1])), plane
    w, x, y, z = from_matrices(rotation).tolist()
    length = math.hypot(x, y, z)
    sign = -1.0 if w < 0 else 1.0
    plane = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    return 2 * math.atan2(length, abs(w)), plane * (sign / length if length else 0.0)


def _drift(growth: float, angle: float, plane: Tensor) -> Tensor:
    """∫₀¹ e^{ρ(g + θK)} dρ with K³ = -K; by φ(z) = (e^z - 1)/z at g and at g + iθ."""
    straight, turning = _phi(growth), _phi(complex(growth, angle))
    square = plane @ plane
    identity = _unit(len(plane))
    return straight.real * identity + turning.imag * plane + (straight.real - turning.real) * square


def _phi(z: complex) -> complex:
    if abs(z) < 0.1:
        # Few terms of the series, where the difference would cancel.
        return 1 + z / 2 * (1 + z / 3 * (1 + z / 4 * (1 + z / 5 * (1 + z / 6 * (1 + z / 7 * (
            1 + z / 8 * (1 + z / 9)
        ))))))  # fmt: skip
    return (cmath.exp(z) - 1) / z


def _unit(dim: int) -> Tensor:
    return torch.eye(dim, dtype=torch.float64)
