"""Flows with drawn weights, points near them, and the laws that any flow is held to."""

from __future__ import annotations

import json

import torch
from torch import Tensor

from splatmorph.flows import (
    NCF,
    Flow,
    Ifmorph,
    Node,
    SirenField,
    SplineField,
    ThinPlate,
    flow_from_config,
    make_flow,
)
from splatmorph.flows.spline import SplineInterpolant


def random_spline(field: SplineField, generator: torch.Generator, size: float = 0.2) -> None:
    centers = torch.rand(12, field.dim, generator=generator, dtype=torch.float64) * 2 - 1
    values = size * torch.randn(12, field.dim, generator=generator, dtype=torch.float64)
    SplineInterpolant(field, centers, 0.0).set_values(values)


def random_flow(options: dict[str, str], dim: int, seed: int) -> Flow:
    """A flow with drawn weights, in a frame that is not the world's."""
    generator = torch.Generator().manual_seed(seed)
    flow = make_flow(dim=dim, **options)
    if isinstance(flow, Node) and isinstance(flow.field, SplineField):
        random_spline(flow.field, generator)
    elif isinstance(flow, Node) and isinstance(flow.field, SirenField):
        random_spline(flow.field.base, generator, size=0.05)
        flow.field.network.initialise(generator)
    elif isinstance(flow, NCF):
        flow.initialise(generator)
        flow.generator.copy_(0.3 * torch.randn(dim, dim, generator=generator))
        flow.drift.copy_(0.3 * torch.randn(dim, generator=generator))
    elif isinstance(flow, Ifmorph):
        flow.network.initialise(generator)
    elif isinstance(flow, ThinPlate):
        random_spline(flow.onward, generator)
        random_spline(flow.back, generator)
    if isinstance(flow, Node):
        flow.steps = 32  # drawn fields are steeper than fitted ones, for which `fit` chooses
    flow.set_frame(torch.linspace(2.0, 3.0, dim), 1.7)
    return flow


def points(flow: Flow, count: int, seed: int, dtype: torch.dtype = torch.float64) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    unit = 0.8 * (torch.rand(count, flow.dim, generator=generator, dtype=torch.float64) * 2 - 1)
    return (flow.center + flow.scale * unit).to(dtype)


def gap(flow: Flow, a: Tensor, b: Tensor) -> float:
    return float((a - b).norm(dim=-1).max() / flow.scale)


def keeps_the_group(flow: Flow, s: float, t: float, within: float, seed: int = 0) -> None:
    """Φ₀ = id, Φ₋ₜ∘Φₜ = id and Φₜ∘Φₛ = Φₛ₊ₜ, ``within`` frame units."""
    x = points(flow, 20, seed)
    # Rounding, through every coupling there and back.
    assert gap(flow, flow(x, 0.0), x) < 1e-13
    assert gap(flow, flow(flow(x, t), -t), x) < within
    assert gap(flow, flow(flow(x, s), t), flow(x, s + t)) < within


def differentiates_itself(flow: Flow, seed: int = 0) -> None:
    """The Jacobians of Φ and of the velocity are finite differences."""
    x = points(flow, 8, seed)
    # Knots of every integrator: the derivative is the very one of the steps taken.
    times = (0.625, -0.375)
    path, transported = flow.trajectory_jacobian(x, list(times))
    assert gap(flow, path[0], flow(x, times[0])) < 1e-6
    slope = flow.velocity_jacobian(x)
    h = 1e-5
    steps = h * torch.eye(flow.dim, dtype=torch.float64)[:, None]
    around = torch.stack([x + steps, x - steps])

    def difference(ends: Tensor) -> Tensor:
        ahead, behind = ends.view(around.shape)
        return ((ahead - behind) / (2 * h)).permute(1, 2, 0)

    for k, t in enumerate(times):
        moved = flow(around.flatten(0, 2), t)
        assert torch.allclose(transported[k], difference(moved), atol=1e-4)
    moved = flow.velocity(around.flatten(0, 2))
    assert torch.allclose(slope, difference(moved), atol=1e-5)


def is_saved(flow: Flow) -> None:
    """Its configuration, as JSON, and its state make it again."""
    again = flow_from_config(json.loads(json.dumps(flow.config())))
    again.load_state_dict(flow.state_dict())
    x = points(flow, 5, 2)
    assert torch.equal(again(x, 0.4), flow(x, 0.4))
