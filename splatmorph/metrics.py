"""How good a flow is: landmark error, flow laws, folding, energies."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from splatmorph.flows import Flow

MOST_WITH_JACOBIANS = 20_000
"""Points at which determinants are taken, however many there are."""
MANY_LANDMARKS = 2000
"""Landmarks from which single precision, a hundred times as fast, is precise enough."""
PAPER_TIMES = 10
"""Times at which the paper's landmark metric looks."""
ENERGY_SAMPLES = 2000
PADDING = 0.1
"""How far beyond the landmarks' box a field is looked at, as a part of its sides."""


@dataclass(frozen=True)
class FlowLaws:
    """The largest violations of a flow's laws over some points, in frame units."""

    identity: float
    """max |Φ(x, 0) - x|"""
    inverse: float
    """max |Φ(Φ(x, t), -t) - x| for t = 1/2 and 1"""
    group: float
    """max |Φ(Φ(x, s), t) - Φ(x, s + t)| for a few s, t"""


@dataclass(frozen=True)
class Quality:
    """What a fitted flow does. Squared errors are means a coordinate, the others distances."""

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
    """Each landmark's largest |Φ(p, t) - Φ(q, t - 1)| over t, world units, by name, the worst
    first. At its ends a path can miss by far more than at t = 1/2, where it is fitted."""
    laws: FlowLaws
    det_min: float
    """Least det ∂Φ/∂x(·, 1) over the object; at 0 and below the warp folds."""
    det_max: float
    det_min_at: tuple[float, ...]
    """Where it is least, world units."""
    energy_first: float
    """Mean |∂v/∂x|² over the landmarks' box and a tenth more: the paper's regulariser."""
    energy_second: float
    """Mean |∂²v/∂x²|², frame units, over the same box: the thin-plate energy."""


def landmark_mse(flow: Flow, source: Tensor, target: Tensor, times: int = PAPER_TIMES) -> float:
    """The paper's landmark metric: mean over evenly spaced t in [0, 1] of |Φ(p,t) - Φ(q,t-1)|².

    ``source`` and ``target`` are matched (k, dim) world points. The mean is over landmarks and
    coordinates too: world units squared.
    """
    return float(_gaps(flow, source, target, times).square().mean())


def _gaps(flow: Flow, source: Tensor, target: Tensor, times: int) -> Tensor:
    ts = torch.linspace(0, 1, times, dtype=torch.float64).tolist()
    return flow.trajectory(source, ts) - flow.trajectory(target, [t - 1 for t in ts])


def flow_laws(flow: Flow, x: Tensor) -> FlowLaws:
    """Measure identity, inverse and group law at world points (m, dim)."""

    def gap(a: Tensor, b: Tensor) -> float:
        return float((a - b).norm(dim=1).max() / flow.scale) if len(a) else 0.0

    half, most, whole = (flow(x, t) for t in (0.5, 0.63, 1.0))
    return FlowLaws(
        identity=gap(flow(x, 0.0), x),
        inverse=max(gap(flow(half, -0.5), x), gap(flow(whole, -1.0), x)),
        group=max(
            gap(flow(half, 0.5), whole),
            gap(flow(whole, -0.37), most),
            gap(flow(half, 0.13), most),
        ),
    )


def evaluate(
    flow: Flow, p: Tensor, q: Tensor, names: tuple[str, ...], points: Tensor, seed: int = 0
) -> Quality:
    """Measure a flow at its landmarks p, q (k, dim) and over the object's ``points`` (m, dim).

    Everything in world units; determinants and laws are taken in the dtype of ``points``, and so
    is everything in single precision where the landmarks are very many.
    """
    if len(p) >= MANY_LANDMARKS:
        p, q, points = p.float(), q.float(), points.float()
    square = float(flow.scale) ** 2
    gaps = _gaps(flow, p, q, PAPER_TIMES)
    before, after = float((p - q).square().mean()), float(gaps.square().mean())
    missed = gaps.norm(dim=2).amax(0)
    generator = torch.Generator().manual_seed(seed)
    chosen = points[torch.randperm(len(points), generator=generator)[:MOST_WITH_JACOBIANS]]
    det = torch.linalg.det(flow.jacobian(chosen, 1.0))
    first, second = energies(flow, *padded_box(torch.cat([p, q])), generator)
    return Quality(
        scale=float(flow.scale),
        mse_before=before / square,
        mse=after / square,
        mse_world_before=before,
        mse_world=after,
        errors={names[i]: float(missed[i]) for i in missed.argsort(descending=True).tolist()},
        laws=flow_laws(flow, points),
        det_min=float(det.min()),
        det_max=float(det.max()),
        det_min_at=tuple(chosen[int(det.argmin())].tolist()),
        energy_first=first,
        energy_second=second,
    )


def padded_box(points: Tensor) -> tuple[Tensor, Tensor]:
    """Low and high corner (dim,) of the box of points (m, dim) and ``PADDING`` more."""
    low, high = points.amin(0), points.amax(0)
    return low - PADDING * (high - low), high + PADDING * (high - low)


def energies(
    flow: Flow, low: Tensor, high: Tensor, generator: torch.Generator, step: float = 1e-2
) -> tuple[float, float]:
    """Mean |∂v/∂x|² and, in frame units, |∂²v/∂x²|² over the box between two world corners.

    The second derivatives are central differences, ``step`` frame units apart, so that they are
    had for every kind of flow. In the frame single precision tells six digits of either.
    """
    noise = torch.rand(ENERGY_SAMPLES, flow.dim, generator=generator, dtype=torch.float64)
    u = flow.to_unit(low + noise.to(low) * (high - low)).float()
    first = float(flow.unit_velocity_jacobian(u).square().sum((1, 2)).mean())
    second = 0.0
    for axis in torch.eye(flow.dim).to(u) * step:
        ahead, behind = (flow.unit_velocity_jacobian(x) for x in (u + axis, u - axis))
        second += float(((ahead - behind) / (2 * step)).square().sum((1, 2)).mean())
    return first, second
