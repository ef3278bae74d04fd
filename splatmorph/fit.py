"""fit: landmarks in, a flow that meets them out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import torch
from torch import Tensor

from splatmorph.errors import NonFiniteError
from splatmorph.flows import Flow, Node, SplineField
from splatmorph.flows.spline import SplineInterpolant
from splatmorph.metrics import FlowLaws, flow_laws, landmark_mse


class MatchedLandmarks(Protocol):
    """What ``fit`` asks of ``splatmorph.landmarks.Landmarks``."""

    def match(self, target: Any) -> tuple[Tensor, Tensor, tuple[str, ...]]: ...


@dataclass(frozen=True)
class FitConfig:
    """How to fit. The defaults suit landmarks from hand-placed to dense, in 2D and 3D."""

    seed: int = 0
    steps: int | None = None
    """Most steps to take; None: the recipe's own number."""
    smoothing: float = 0.0
    """How much bending weighs against missed landmarks; 0 meets them as closely as it can."""
    tolerance: float = 1e-8
    """Stop when the mean squared landmark error, in frame units, is below this."""


@dataclass(frozen=True)
class FitProgress:
    """One step of a fit."""

    step: int
    steps: int
    mse: float
    """Mean squared landmark error a coordinate, frame units."""
    seconds: float


@dataclass(frozen=True)
class FitState:
    """All that is needed to go on with an interrupted fit."""

    tensors: dict[str, Tensor]
    meta: dict[str, str]


@dataclass(frozen=True)
class FitReport:
    """What a fit achieved. Errors are per coordinate where squared, Euclidean otherwise."""

    kind: str
    landmarks: int
    scale: float
    """World units a frame unit: half the extent of the landmarks' common box."""
    mse_before: float
    """The paper's landmark metric of doing nothing, frame units squared."""
    mse: float
    """The paper's landmark metric of the fitted flow, frame units squared."""
    mse_world_before: float
    mse_world: float
    """The same two in world units squared."""
    errors: dict[str, float]
    """|Φ(p, 1) - q| of each landmark in world units, by name."""
    laws: FlowLaws
    steps: int
    seconds: float
    interrupted: bool
    status: str
    """One line: how the fit ended."""
    history: tuple[FitProgress, ...] = field(repr=False, default=())

    def to_dict(self) -> dict[str, Any]:
        """Everything but the history, in JSON's types."""
        return {name: value for name, value in asdict(self).items() if name != "history"}


def fit(
    flow: Flow,
    source: MatchedLandmarks,
    target: MatchedLandmarks,
    config: FitConfig = FitConfig(),  # noqa: B008 - frozen
    *,
    domain: Tensor | None = None,
    on_step: Callable[[FitProgress], None] | None = None,
    resume: FitState | None = None,
    on_state: Callable[[FitState], None] | None = None,
) -> FitReport:
    """Fit ``flow`` in place so that it takes the landmarks of ``source`` to those of ``target``.

    ``domain`` are (m, dim) world points where the object is. ``KeyboardInterrupt`` keeps the best
    flow so far. Raises ``LandmarkError`` where the landmarks don't match and ``NonFiniteError``
    where the flow blew up.
    """
    p, q, names = source.match(target)
    p, q = p.double(), q.double()
    both = torch.cat([p, q])
    low, high = both.amin(0), both.amax(0)
    flow.set_frame((low + high) / 2, float((high - low).max() / 2))
    begun = time.perf_counter()
    history: list[FitProgress] = []

    def record(step: int, steps: int, mse: float) -> None:
        if not torch.isfinite(torch.tensor(mse)):
            raise NonFiniteError(
                f"the landmark error became {mse} in step {step}: the landmarks "
                "contradict each other, look at the worst ones"
            )
        history.append(FitProgress(step, steps, mse, time.perf_counter() - begun))
        if on_step is not None:
            on_step(history[-1])

    assert isinstance(flow, Node)
    _solve(flow, flow.field, flow.to_unit(p), flow.to_unit(q), config, record)
    seconds = time.perf_counter() - begun
    before = float((p - q).square().mean())
    after = landmark_mse(flow, p, q)
    square = float(flow.scale) ** 2
    return FitReport(
        kind=flow.kind,
        landmarks=len(p),
        scale=float(flow.scale),
        mse_before=before / square,
        mse=after / square,
        mse_world_before=before,
        mse_world=after,
        errors=dict(zip(names, (flow(p, 1.0) - q).norm(dim=1).tolist(), strict=True)),
        laws=flow_laws(flow, both if domain is None else domain.double()[:2000]),
        steps=len(history),
        seconds=seconds,
        interrupted=False,
        status="met",
        history=tuple(history),
    )


def _solve(
    flow: Node,
    spline: SplineField,
    p: Tensor,
    q: Tensor,
    config: FitConfig,
    record: Callable[[int, int, float], None],
) -> None:
    """Fixed point on the half-time residual: the values at the midpoints that make ends meet."""
    pairs = torch.unique(torch.cat([p, q], dim=1), dim=0)
    p, q = pairs[:, : flow.dim], pairs[:, flow.dim :]
    interpolant = SplineInterpolant(spline, (p + q) / 2, config.smoothing)
    data = q - p
    steps = config.steps or 6
    sign = torch.cat([torch.full((len(p),), 0.5), torch.full((len(q),), -0.5)])
    tried: list[tuple[Tensor, Tensor]] = []
    for step in range(steps):
        interpolant.set_values(data)
        halves = flow.unit_forward(torch.cat([p, q]), sign)
        missed = halves[len(p) :] - halves[: len(p)]
        mse = float(missed.square().mean())
        record(step + 1, steps, mse)
        if mse < config.tolerance:
            break
        change = spline(interpolant.centers) + missed - data
        tried.append((data, change))
        data = anderson(tried)


def anderson(tried: list[tuple[Tensor, Tensor]]) -> Tensor:
    """The next iterate of x ← x + f(x) from all (x, f(x)) so far, by Anderson acceleration."""
    x, f = tried[-1]
    if len(tried) == 1:
        return x + f
    dx = torch.stack([(x - a).flatten() for a, _ in tried[:-1]], 1)
    df = torch.stack([(f - b).flatten() for _, b in tried[:-1]], 1)
    mix = torch.linalg.lstsq(df, f.flatten()[:, None]).solution
    return x + f - ((dx + df) @ mix).reshape(x.shape)
