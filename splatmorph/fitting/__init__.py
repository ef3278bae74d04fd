"""fit: landmarks in, a flow that meets them out."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import torch
from torch import Tensor

from splatmorph.errors import LandmarkError, NonFiniteError
from splatmorph.fitting.diagnosis import MISSED, SQUEEZED, choose_steps, contradictions
from splatmorph.fitting.methods import fitted_by, method_of
from splatmorph.fitting.report import ENERGIES, FitConfig, FitProgress, FitReport, FitState
from splatmorph.fitting.task import Region, Task
from splatmorph.flows import Flow, Node
from splatmorph.landmarks import Landmarks
from splatmorph.metrics import Quality, evaluate

__all__ = [
    "ENERGIES",
    "FitConfig",
    "FitProgress",
    "FitReport",
    "FitState",
    "Task",
    "fit",
    "fitted_by",
]

DEFAULTS = FitConfig()
"""The settings of a fit that is asked for nothing else."""
PROBES = 128
"""Points of the object at which a report looks."""
INTEGRATION_SHARE = 0.1
"""The integration error may be this part of the root mean squared landmark error …"""
INTEGRATION_FLOOR = 2e-6
"""… or this many frame units, whichever is more."""


def fit(
    flow: Flow,
    source: Landmarks,
    target: Landmarks,
    config: FitConfig = DEFAULTS,
    *,
    domain: Tensor | None = None,
    on_step: Callable[[FitProgress], None] | None = None,
    resume: FitState | None = None,
    on_state: Callable[[FitState], None] | None = None,
) -> FitReport:
    """Fit ``flow`` in place so that Φ(p, t) = Φ(q, t - 1) for the matched landmarks p and q.

    The flow's frame is laid first, so that the landmarks of both sides fill [-1, 1]^dim; then the
    flow is solved for or trained, as ``methods`` says of its class. Everything runs where the flow
    is, the landmarks included.

    Arguments:
        source, target: landmarks in world units, matched by ``source.match(target)``.
        domain: (m, dim) world points where the object is; the energy is kept small there beside
            the landmarks' box, and the report looks there.
        on_step: called with the progress.
        on_state: called now and then by a training, with what ``resume`` takes to go on.

    ``KeyboardInterrupt`` ends a fit early: the best flow so far is kept and the report says so.

    Raises:
        LandmarkError: the landmarks don't match, or all lie in one point.
        FitError: the flow has nothing to fit, or became NaN or infinite.
    """
    p, q, names = source.match(target)
    device = flow.center.device
    p, q = p.to(device), q.to(device)
    _lay_frame(flow, p, q)
    begun = time.perf_counter()
    history: list[FitProgress] = []

    def record(step: int, steps: int, mse: float) -> None:
        history.append(FitProgress(step, steps, mse, time.perf_counter() - begun))
        if on_step is not None:
            on_step(history[-1])

    ends = flow.to_unit(p), flow.to_unit(q)
    inside = None if domain is None else flow.to_unit(domain.to(p)).float()
    region = Region(torch.cat(ends).float(), inside)
    task = Task(*ends, region, config, record, resume, on_state)
    try:
        finished = method_of(flow)(flow, task)
    except KeyboardInterrupt:
        finished = False
    seconds = time.perf_counter() - begun
    return _report(flow, p, q, names, domain, config, history, seconds, finished)


def _lay_frame(flow: Flow, p: Tensor, q: Tensor) -> None:
    both = torch.cat([p, q])
    low, high = both.amin(0), both.amax(0)
    half = float((high - low).max() / 2)
    if half == 0:
        raise LandmarkError("all landmarks lie in one point, expected points on an object")
    flow.set_frame((low + high) / 2, half)


def _report(
    flow: Flow,
    p: Tensor,
    q: Tensor,
    names: tuple[str, ...],
    domain: Tensor | None,
    config: FitConfig,
    history: list[FitProgress],
    seconds: float,
    finished: bool,
) -> FitReport:
    generator = torch.Generator().manual_seed(config.seed)
    everywhere = torch.cat([p, q]) if domain is None else domain.to(p)
    probes = everywhere[torch.randperm(len(everywhere), generator=generator)[:PROBES]]
    if isinstance(flow, Node):
        rms = (history[-1].mse if history else 0.0) ** 0.5
        accuracy = max(INTEGRATION_SHARE * rms, INTEGRATION_FLOOR)
        flow.steps = choose_steps(
            flow, flow.to_unit(torch.cat([p[:PROBES], q[:PROBES], probes])), accuracy
        )
    quality = evaluate(flow, p, q, names, probes, config.seed)
    if not math.isfinite(quality.mse):
        raise NonFiniteError(
            "the fitted flow is NaN or infinite at its landmarks: look for landmarks that "
            "contradict each other, or raise the smoothing"
        )
    warnings = contradictions(p, q, names)
    if quality.det_min < SQUEEZED:
        does = "folds" if quality.det_min <= 0 else "squeezes"
        where = ", ".join(f"{value:.4g}" for value in quality.det_min_at)
        warnings.append(f"the warp {does} (det {quality.det_min:.2g}) near ({where})")
    return FitReport(
        **vars(quality),
        kind=flow.kind,
        landmarks=len(p),
        steps=history[-1].step if history else 0,
        seconds=seconds,
        interrupted=not finished,
        status=_status(quality, finished),
        warnings=tuple(warnings),
        history=tuple(history),
    )


def _status(quality: Quality, finished: bool) -> str:
    how = "" if finished else "interrupted, the best so far is kept: "
    missed = {n: error for n, error in quality.errors.items() if error > MISSED * quality.scale}
    if not missed:
        return f"{how}landmarks met"
    named = ", ".join(f"{name} by {error:.3g}" for name, error in list(missed.items())[:3])
    return (
        f"{how}{len(missed)} of {len(quality.errors)} landmarks missed by more than "
        f"{MISSED * quality.scale:.2g}, worst {named}"
    )
