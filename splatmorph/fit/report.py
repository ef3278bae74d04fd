"""What goes into a fit and what comes out: settings, progress, state, report."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from torch import Tensor

from splatmorph.errors import OptionError
from splatmorph.metrics import FlowLaws

ENERGIES = ("jacobian", "hessian")


@dataclass(frozen=True)
class FitConfig:
    """How to fit. The defaults suit landmarks from hand-placed to dense, in 2D and 3D.

    Raises ``OptionError`` where a value can't be.
    """

    seed: int = 0
    """Of everything that is drawn: the same seed gives the same bits."""
    steps: int | None = None
    """Most steps to take; None: the number of the flow's own recipe."""
    smoothing: float = 0.0
    """How much bending weighs against missed landmarks, ≥ 0; 0 meets them as closely as it can."""
    tolerance: float = 1e-8
    """Stop when the mean squared landmark error, in frame units, is below this."""
    energy: str | None = None
    """What a trained field keeps small: "jacobian" (the paper's) or "hessian"; None: the better."""

    def __post_init__(self) -> None:
        if not 0 <= self.smoothing < float("inf"):
            raise OptionError(f"smoothing is {self.smoothing}, expected a number ≥ 0")
        if self.steps is not None and self.steps < 1:
            raise OptionError(f"steps is {self.steps}, expected at least 1")
        if self.energy not in (None, *ENERGIES):
            raise OptionError(
                f"energy '{self.energy}' is unknown: choose one of {', '.join(ENERGIES)}"
            )


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


@dataclass(frozen=True)
class FitReport:
    """What a fit achieved. Squared errors are means a coordinate, the others are distances."""

    kind: str
    landmarks: int
    scale: float
    """World units a frame unit: half the longest side of the landmarks' common box."""
    mse_before: float
    """The paper's landmark metric of doing nothing, frame units squared."""
    mse: float
    """The paper's landmark metric of the fitted flow, frame units squared."""
    mse_world_before: float
    mse_world: float
    """The same two in world units squared."""
    errors: dict[str, float]
    """|Φ(p, 1) - q| of each landmark, world units, by name, the worst first."""
    laws: FlowLaws
    det_min: float
    """Least det ∂Φ/∂x(·, 1) over the object; below 0 the warp folds."""
    det_max: float
    det_min_at: tuple[float, ...]
    """Where it is least, world units."""
    energy_first: float
    """Mean |∂v/∂x|² over the object's box: the paper's regulariser."""
    energy_second: float
    """Mean |∂²v/∂x²|² in frame units over the same box: the thin-plate energy."""
    steps: int
    seconds: float
    """Time to fit, without this report."""
    interrupted: bool
    status: str
    """One line: how the fit ended."""
    warnings: tuple[str, ...]
    """What the landmarks can't have meant, one line each."""
    history: tuple[FitProgress, ...] = field(repr=False, default=())

    def to_dict(self) -> dict[str, Any]:
        """Everything but the history, in JSON's types."""
        kept = {name: value for name, value in asdict(self).items() if name != "history"}
        return {k: list(v) if isinstance(v, tuple) else v for k, v in kept.items()}
