"""fit: landmarks in, a flow that meets them out."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import compress

import torch
from torch import Tensor

from splatmorph.errors import LandmarkError, NonFiniteError
from splatmorph.fitting.choice import choose
from splatmorph.fitting.diagnosis import (
    SQUEEZED,
    choose_steps,
    contradictions,
    missed_by_far,
    standing_apart,
    status_of,
)
from splatmorph.fitting.methods import fitted_by, method_of
from splatmorph.fitting.report import ENERGIES, FitConfig, FitProgress, FitReport, FitState
from splatmorph.fitting.task import Region, Task
from splatmorph.flows import Flow, Node
from splatmorph.flows.linear import Linear
from splatmorph.landmarks import Landmarks
from splatmorph.metrics import evaluate
from splatmorph.steady import one_thread

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
PLANE_SMOOTHING = 1e-4
"""Landmarks of pictures are good to a pixel or so: this meets them to that."""
INTEGRATION_SHARE = 0.1
"""The integration error may be this part of the root mean squared landmark error …"""
INTEGRATION_FLOOR = 2e-6
"""… or this many frame units, whichever is more."""


@one_thread()
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

    The flow's frame is laid first, so that the landmarks of both sides fill [-1, 1]^dim; then how
    far to trust them is chosen, unless ``config`` says it, and the flow is solved for or trained,
    as ``methods`` says of its class. Everything runs where the flow is, the landmarks included;
    on the CPU same inputs give the same bits, whatever its cores.
    What a target that is turned, moved or of another size stands apart by is not for a flow:

        frame = source.similarity_to(target)
        report = fit(flow, source, target.moved(frame.inverse()))
        morph = Morph(a, b, flow, frame=frame)

    Where that was left in and landmarks are missed, the report warns of it, and so does the log.
    Landmarks that a search found, having a confidence, are not held against one another.

    Arguments:
        source: landmarks in world units.
        target: where they go, matched by ``source.match(target)``.
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
    chosen, predicted = _chosen(flow, *ends, config)
    task = Task(*ends, region, chosen, record, resume, on_state)
    try:
        finished = method_of(flow)(flow, task)
    except KeyboardInterrupt:
        finished = False
    seconds = time.perf_counter() - begun
    report = _report(flow, p, q, names, domain, chosen, history, seconds, finished)
    given = source.given(names) & target.given(names)
    trusted = [side[given.to(device)] for side in ends]
    doubts = contradictions(trusted[0], trusted[1], tuple(compress(names, given.tolist())))
    doubts += standing_apart(report, p, q)
    asked = config.smoothing is not None or flow.kind == Linear.kind
    return replace(
        report,
        predicted=predicted,
        warnings=(*doubts, *report.warnings),
        status=status_of(report, asked=asked),
        missed=not asked and missed_by_far(report),
    )


def _chosen(flow: Flow, p: Tensor, q: Tensor, config: FitConfig) -> tuple[FitConfig, float | None]:
    """The settings with smoothing and shear, and within what the landmarks predict one another."""
    if config.smoothing is not None or flow.kind == Linear.kind:
        return config, None
    if flow.dim == 2:
        return replace(config, smoothing=PLANE_SMOOTHING), None
    found = choose(p, q)
    shear = found.shear if config.shear is None else config.shear
    chosen = replace(config, smoothing=found.smoothing, shear=shear)
    return chosen, found.predicted * float(flow.scale)


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
    warnings = []
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
        status="",
        missed=False,
        smoothing=config.bending,
        predicted=None,
        warnings=tuple(warnings),
        history=tuple(history),
    )
