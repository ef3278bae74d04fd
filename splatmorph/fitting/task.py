"""Task: what a method of fitting is given, in the frame of the flow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from splatmorph.fitting.report import FitConfig, FitState
from splatmorph.fitting.solve import Record
from splatmorph.fitting.train import Objective, train
from splatmorph.metrics import padded_box


class Region:
    """Where the energy is sampled: the landmarks' padded box and, where given, the object."""

    def __init__(self, points: Tensor, domain: Tensor | None) -> None:
        self.low, high = padded_box(points)
        self.sides = high - self.low
        self.domain = domain

    def sample(self, count: int, generator: torch.Generator, beyond: float = 0.0) -> Tensor:
        """(count, dim) points; half of them from the object where there is one.

        ``beyond``: by what part of its sides the box is made larger at every face.
        """
        noise = (1 + 2 * beyond) * torch.rand(count, len(self.low), generator=generator) - beyond
        box = self.low + noise.to(self.low) * self.sides
        if self.domain is None:
            return box
        chosen = torch.randint(len(self.domain), (count // 2,), generator=generator)
        return torch.cat([box[count // 2 :], self.domain[chosen.to(self.domain.device)]])


@dataclass(frozen=True)
class Task:
    """Φ(p, t) = Φ(q, t - 1) for landmarks p and q, and what else a fit is told.

    Everything in frame coordinates, where the flow is.
    """

    p: Tensor
    """(k, dim) float64, the source's landmarks."""
    q: Tensor
    """(k, dim) float64, the target's."""
    region: Region
    config: FitConfig
    record: Record
    """Called with the progress."""
    resume: FitState | None = None
    on_state: Callable[[FitState], None] | None = None

    def train(self, objective: Objective) -> bool:
        """Train on ``objective`` in place; False where the user interrupted it.

        Raises:
            NonFiniteError: every attempt blew up.
        """
        return train(objective, self.config, self.record, self.resume, self.on_state)
