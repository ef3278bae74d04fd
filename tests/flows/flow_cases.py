"""Flows with drawn weights, and points near them."""

from __future__ import annotations

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
        flow.steps = 32  # drawn networks are steeper than fitted ones, for which `fit` chooses
    elif isinstance(flow, NCF):
        flow.initialise(generator)
        flow.generator.copy_(0.3 * torch.randn(dim, dim, generator=generator))
        flow.drift.copy_(0.3 * torch.randn(dim, generator=generator))
    elif isinstance(flow, Ifmorph):
        flow.network.initialise(generator)
    elif isinstance(flow, ThinPlate):
        random_spline(flow.onward, generator)
        random_spline(flow.back, generator)
    flow.set_frame(torch.linspace(2.0, 3.0, dim), 1.7)
    return flow


def points(flow: Flow, count: int, seed: int, dtype: torch.dtype = torch.float64) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    unit = 0.8 * (torch.rand(count, flow.dim, generator=generator, dtype=torch.float64) * 2 - 1)
    return (flow.center + flow.scale * unit).to(dtype)


def gap(flow: Flow, a: Tensor, b: Tensor) -> float:
    return float((a - b).norm(dim=-1).max() / flow.scale)
