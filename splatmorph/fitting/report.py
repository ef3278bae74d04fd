"""What goes into a fit and what comes out: settings, progress, state, report."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from torch import Tensor

from splatmorph.errors import OptionError
from splatmorph.metrics import Quality

ENERGIES = ("jacobian", "hessian", "none")
SMOOTHING = 2e-4
"""Moves landmarks by one or two parts in 10⁴ of the box, and keeps two that nearly coincide from
wrinkling the field between them."""


@dataclass(frozen=True)
class FitConfig:
    """How to fit. The defaults suit landmarks from hand-placed to dense, in 2D and 3D.

    Raises ``OptionError`` where a value can't be.
    """

    seed: int = 0
    """Of everything that is drawn: the same seed gives the same bits."""
    steps: int | None = None
    """Most steps to take; None: the number of the flow's own recipe."""
    smoothing: float | None = None
    """How much bending weighs against missed landmarks, ≥ 0: raise it for noisy ones. The spline
    minimises Σ|gap|² + smoothing · bending in frame units; a training's energy weighs in
    proportion. At 0 the landmarks are met as closely as can be, whatever it costs between them.
    None: in space as much as the landmarks ask for, by how they predict one another; in the
    plane 1e-4."""
    shear: float | None = None
    """Prior variance of a linear part that is no similarity, frame units. None: chosen with the
    smoothing, else free."""
    tolerance: float = 1.5e-8
    """Stop when the mean squared landmark error, in frame units, is below this."""
    energy: str | None = None
    """What a trained field keeps small: "jacobian" (the paper's), "hessian", or "none" to see what
    it is good for; None: the flow's own choice."""

    def __post_init__(self) -> None:
        if self.smoothing is not None and not 0 <= self.smoothing < float("inf"):
            raise OptionError(f"smoothing is {self.smoothing}, expected a number ≥ 0")
        if self.shear is not None and not 0 < self.shear < float("inf"):
            raise OptionError(f"shear is {self.shear}, expected a number above 0")
        if self.steps is not None and self.steps < 1:
            raise OptionError(f"steps is {self.steps}, expected at least 1")
        if self.energy not in (None, *ENERGIES):
            raise OptionError(
                f"energy '{self.energy}' is unknown: choose one of {', '.join(ENERGIES)}"
            )

    @property
    def bending(self) -> float:
        """The smoothing λ, its least where nothing has been chosen."""
        return SMOOTHING if self.smoothing is None else self.smoothing


@dataclass(frozen=True)
class FitProgress:
    """One step of a fit."""

    step: int
    steps: int
    mse: float
    """Mean squared landmark error a coordinate, frame units squared."""
    seconds: float


@dataclass(frozen=True)
class FitState:
    """All that is needed to go on with an interrupted training."""

    tensors: dict[str, Tensor]
    meta: dict[str, str]
    origin: str = "the state to resume from"
    """What it is called where it can't be gone on with."""


@dataclass(frozen=True)
class FitReport(Quality):
    """What a fit achieved: the flow's quality, and how it came about."""

    kind: str
    landmarks: int
    steps: int
    seconds: float
    """Time to fit, without this report."""
    interrupted: bool
    status: str
    """One line: how the fit ended."""
    missed: bool
    """Whether many landmarks are missed by far, and nobody asked for that."""
    smoothing: float
    """The weight of bending that was given or chosen."""
    predicted: float | None
    """Mean distance within which the landmarks predict one another, each from all others, world
    units; None where it was not looked for."""
    warnings: tuple[str, ...]
    """What the landmarks can't have meant, one line each."""
    history: tuple[FitProgress, ...] = field(repr=False, default=())

    def to_dict(self) -> dict[str, Any]:
        """Everything but the history, in JSON's types."""
        kept = {name: value for name, value in asdict(self).items() if name != "history"}
        return {k: list(v) if isinstance(v, tuple) else v for k, v in kept.items()}
