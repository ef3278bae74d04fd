"""Fits without training: a field that is linear in its weights is solved for."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from splatmorph.fitting.report import FitConfig
from splatmorph.flows.native import path
from splatmorph.flows.node import runge_kutta
from splatmorph.flows.spline import SplineField, SplineInterpolant
from splatmorph.flows.thin_plate import ThinPlate
from splatmorph.metrics import MANY_LANDMARKS

SPLINE_STEPS = 12
PATIENCE = 3
"""Steps without a smaller residual after which the landmarks are taken for contradictory."""
COMPARABLE = 4.0
"""Iterates whose mean squared residual is within this factor of the least compete for the best."""
TRAINING_STEP = 0.25
"""Longest Runge-Kutta step while fitting; a longer one meets the landmarks only by itself."""

Record = Callable[[int, int, float], None]
"""(step, steps, mean squared landmark error a coordinate)"""


def half_time_gap(velocity: Callable[[Tensor], Tensor], p: Tensor, q: Tensor) -> Tensor:
    """Φ(q, -1/2) - Φ(p, 1/2), (k, dim): zero where an autonomous flow meets its landmarks."""
    steps = round(0.5 / TRAINING_STEP)
    if len(p) >= MANY_LANDMARKS and isinstance(velocity, SplineField):
        single = p.float(), q.float()
        if all(path.takes(velocity, x, jacobian=False) for x in single):
            forward, backward = (
                path.states(velocity, x, h, steps, jacobian=False, every=steps)[-1]
                for x, h in zip(single, (TRAINING_STEP, -TRAINING_STEP), strict=True)
            )
            return (backward - forward).to(p)
    half = torch.full((len(p), 1), 0.5, dtype=p.dtype, device=p.device)
    ends = runge_kutta(velocity, torch.cat([p, q]), torch.cat([half, -half]), steps)
    return ends[len(p) :] - ends[: len(p)]


def affine_velocity(p: Tensor, q: Tensor) -> Tensor:
    """The affine map closest to q - p at the midpoints, (1 + dim, dim), its constant first."""
    middle = (p + q) / 2
    design = torch.cat([torch.ones_like(middle[:, :1]), middle], dim=1)
    return torch.linalg.pinv(design) @ (q - p)


def solve_spline(
    field: SplineField,
    p: Tensor,
    q: Tensor,
    config: FitConfig,
    record: Record,
    velocity: Callable[[Tensor], Tensor] | None = None,
) -> None:
    """Make ``field`` the spline whose flow takes p to q (k, dim), frame coordinates.

    The unknowns are its values at the midpoints. To first order the half-time gap answers one to
    one to them, so they are corrected by the gap itself, with Anderson's acceleration; the spline
    system is factorised once. With smoothing λ > 0 the fixed point minimises Σ|gap|² + λ·bending.

    Landmarks that no stationary flow can meet have no fixed point: closing their gap at half-time
    squeezes the space between them until their ends move apart. Then the iterate that is best
    over the whole path is kept.

    ``velocity``, where given, is what flows: a field of which ``field`` is only the last
    correction, so that it begins at zero.
    """
    p, q = _distinct(p, q)
    interpolant = SplineInterpolant(field, (p + q) / 2, config.bending, config.shear)
    data = q - p if velocity is None else torch.zeros_like(p)
    flowing = velocity or field
    steps = config.steps or SPLINE_STEPS
    tried: list[tuple[Tensor, Tensor]] = []
    residuals: list[float] = []
    for step in range(steps):
        interpolant.set_values(data)
        gap = half_time_gap(flowing, p, q)
        mse = float(gap.square().mean())
        record(step + 1, steps, mse)
        if not math.isfinite(mse):
            break
        # The field misses its data by λ times its weights; at the fixed point the gap makes up.
        change = gap - config.bending * field.weights
        residuals.append(float(change.square().mean()))
        if residuals[-1] < config.tolerance:
            return
        tried.append((data, change))
        if min(residuals) < min(residuals[-PATIENCE:]):
            break
        data = anderson(tried)

    def error(values: Tensor) -> float:
        interpolant.set_values(values)
        return path_error(flowing, p, q)

    near = [
        values
        for (values, _), residual in zip(tried, residuals, strict=True)
        if residual <= (COMPARABLE if len(p) < MANY_LANDMARKS else 1.0) * min(residuals)
    ]
    if near:
        interpolant.set_values(near[0] if len(near) == 1 else min(near, key=error))


def path_error(velocity: Callable[[Tensor], Tensor], p: Tensor, q: Tensor) -> float:
    """Mean squared landmark error a coordinate at both ends, Φ(p, 1) - q and Φ(q, -1) - p."""
    whole = torch.ones_like(p[:, :1])
    ends = runge_kutta(
        velocity, torch.cat([p, q]), torch.cat([whole, -whole]), round(1 / TRAINING_STEP)
    )
    error = float((ends - torch.cat([q, p])).square().mean())
    return error if math.isfinite(error) else math.inf


def anderson(tried: list[tuple[Tensor, Tensor]]) -> Tensor:
    """The next iterate of x ← x + f(x), from every (x, f(x)) so far (Anderson 1965)."""
    x, f = tried[-1]
    if len(tried) == 1:
        return x + f
    dx = torch.stack([(x - earlier).flatten() for earlier, _ in tried[:-1]], 1)
    df = torch.stack([(f - earlier).flatten() for _, earlier in tried[:-1]], 1)
    # By QR: the default driver's result depends on where its buffers happen to lie.
    mix = torch.linalg.lstsq(df, f.flatten()[:, None], driver="gels").solution
    if not torch.isfinite(mix).all():
        return x + f
    return x + f - ((dx + df) @ mix).reshape(x.shape)


def _distinct(p: Tensor, q: Tensor) -> tuple[Tensor, Tensor]:
    # Pairs with one midpoint would make the spline system singular: their mean stands for them.
    # The rounding is far below what a landmark can mean.
    _, which = torch.unique(((p + q) / 2 * 1e9).round(), dim=0, return_inverse=True)
    count = int(which.max()) + 1
    if count == len(p):
        return p, q
    size = torch.bincount(which).to(p)[:, None]
    mean = [torch.zeros(count, p.shape[1]).to(p).index_add(0, which, x) / size for x in (p, q)]
    return mean[0], mean[1]


def solve_displacement(flow: ThinPlate, p: Tensor, q: Tensor, config: FitConfig) -> None:
    """Make ``flow`` the thin-plate displacement between p and q (k, dim), and back."""
    SplineInterpolant(flow.onward, p, config.bending, config.shear).set_values(q - p)
    SplineInterpolant(flow.back, q, config.bending, config.shear).set_values(p - q)
