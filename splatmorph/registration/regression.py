"""A spline field that follows many uncertain pairs: weighted regression on the half-time gap."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from splatmorph.flows import Node, SplineField
from splatmorph.geometry.spreading import farthest

ROUNDING = 2e-2
STEPS = 4
"""Runge-Kutta steps a unit of t."""
CORRECTIONS = 2


@dataclass(frozen=True)
class Pairs:
    """k points p that should flow to q, each with its weight."""

    p: Tensor
    """(k, 3)"""
    q: Tensor
    """(k, 3)"""
    weights: Tensor
    """(k,)"""

    @staticmethod
    def join(*parts: Pairs) -> Pairs:
        """All of them."""
        return Pairs(*(torch.cat(column) for column in zip(*map(astuple, parts), strict=True)))


@dataclass(frozen=True)
class Planes:
    """k points p that should flow onto the plane through q with a normal."""

    p: Tensor
    q: Tensor
    weights: Tensor
    normals: Tensor
    """(k, 3) unit vectors."""


def astuple(pairs: Pairs) -> tuple[Tensor, Tensor, Tensor]:
    """The columns of pairs."""
    return pairs.p, pairs.q, pairs.weights


def still() -> Node:
    """The flow that moves nothing."""
    return Node(3, SplineField(3, rounding=ROUNDING), STEPS)


def flow(node: Node, points: Tensor, t: float) -> Tensor:
    """Φ(x, t) of points (m, 3), float32."""
    with torch.no_grad():
        return node.unit_forward(points.float(), t)


def regress(
    start: Node,
    pairs: Pairs,
    planes: Planes | None = None,
    *,
    bending: float,
    centers: int,
    corrections: int = CORRECTIONS,
) -> Node:
    """The flow of the spline field that minimises, over its weights w and affine part,

        Σ weight·|gap|² + Σ weight·(normal·gap)² + bending · wᵀKw,

    gap = Φ(q, -1/2) - Φ(p, 1/2). To first order the gap answers one to one to the velocity at the
    midpoint, so that the field is corrected by regression on the gap itself, starting from the
    flow ``start``. Its centers are ``centers`` of the midpoints, far apart.
    """
    p, q = pairs.p, pairs.q
    if planes is not None:
        p, q = torch.cat([p, planes.p]), torch.cat([q, planes.q])
    middle = ((p + q) / 2).double()
    knots = middle[torch.from_numpy(farthest(middle.numpy(), centers, first=0))]
    system = _System(SplineField(3, rounding=ROUNDING), knots, middle, pairs, planes, bending)
    node = start
    for _ in range(corrections):
        gap = (flow(node, q, -0.5) - flow(node, p, 0.5)).double()
        node = Node(3, system.solve(node.field(middle) + gap), STEPS)
    return node


class _System:
    """The normal equations, factorised once: three axes that the planes couple."""

    def __init__(
        self,
        field: SplineField,
        knots: Tensor,
        middle: Tensor,
        pairs: Pairs,
        planes: Planes | None,
        bending: float,
    ) -> None:
        self.rounding, self.knots, self.count = field.rounding, knots, len(knots)
        affine = torch.cat([torch.ones_like(knots[:, :1]), knots], 1)
        design = torch.cat([field.kernel(middle, knots), torch.ones_like(middle[:, :1]), middle], 1)
        self.unknowns = design.shape[1]
        self.isotropic, self.weights = design[: len(pairs.p)], pairs.weights.double()
        self.coupled = design[len(pairs.p) :]
        self.normals = planes.normals.double() if planes else middle.new_zeros(0, 3)
        self.plane_weights = planes.weights.double() if planes else middle.new_zeros(0)
        size = 3 * self.unknowns
        system = middle.new_zeros(size + 12, size + 12)
        shared = (self.isotropic * self.weights[:, None]).T @ self.isotropic
        shared[: self.count, : self.count] += bending * field.kernel(knots, knots)
        shared[: self.count, : self.count].diagonal().add_(1e-11)
        for i in range(3):
            for j in range(i, 3):
                along = self.plane_weights * self.normals[:, i] * self.normals[:, j]
                block = (self.coupled * along[:, None]).T @ self.coupled
                if i == j:
                    block += shared
                self._block(system, i, j).copy_(block)
                self._block(system, j, i).copy_(block)
        for i in range(3):
            # The spline's side conditions: its weights sum to zero against affine functions.
            rows = slice(size + 4 * i, size + 4 * (i + 1))
            columns = slice(i * self.unknowns, i * self.unknowns + self.count)
            system[rows, columns] = affine.T
            system[columns, rows] = affine
        self.size = size
        self.factors = torch.linalg.lu_factor(system)

    def _block(self, system: Tensor, i: int, j: int) -> Tensor:
        n = self.unknowns
        return system[i * n : (i + 1) * n, j * n : (j + 1) * n]

    def solve(self, velocities: Tensor) -> SplineField:
        """The field that fits velocities (k, 3) at all midpoints, planes' after the pairs'."""
        free, bound = velocities[: len(self.isotropic)], velocities[len(self.isotropic) :]
        along = (self.plane_weights * (self.normals * bound).sum(1))[:, None] * self.normals
        right = self.isotropic.T @ (self.weights[:, None] * free) + self.coupled.T @ along
        padded = torch.cat([right.T.flatten(), right.new_zeros(12)])[:, None]
        solution = torch.linalg.lu_solve(*self.factors, padded)[: self.size, 0]
        solution = solution.reshape(3, self.unknowns).T
        field = SplineField(3, rounding=self.rounding)
        field.set(self.knots, solution[: self.count], solution[self.count :])
        return field
