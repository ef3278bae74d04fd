"""A flow is a one-parameter group: identity, inverse, composition, and the derivatives of it."""

from __future__ import annotations

import pytest
import torch
from flow_cases import (
    differentiates_itself,
    gap,
    is_saved,
    keeps_the_group,
    points,
    random_flow,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from splatmorph.errors import OptionError
from splatmorph.flows import Flow, Linear, Node, SplineField, make_flow

FLOWS: tuple[dict[str, str], ...] = (
    {"kind": "node", "field": "spline"},
    {"kind": "node", "field": "siren"},
    {"kind": "node", "field": "siren", "activation": "sigmoid"},
    {"kind": "ncf"},
    {"kind": "ncf", "activation": "sigmoid"},
)
BASELINES: tuple[dict[str, str], ...] = ({"kind": "tps"}, {"kind": "ifmorph"}, {"kind": "linear"})
DIMS = (2, 3)

flows = pytest.mark.parametrize("options", FLOWS, ids=lambda o: "-".join(o.values()))
warps = pytest.mark.parametrize("options", FLOWS + BASELINES, ids=lambda o: "-".join(o.values()))
dims = pytest.mark.parametrize("dim", DIMS)
few = settings(max_examples=5, deadline=None)
seeds = st.integers(0, 10_000)
times = st.floats(-1.0, 1.0)


def order_of(flow: Flow) -> float:
    """What the laws hold to: an ODE to its integrator, a closed form to rounding."""
    return 2e-5 if isinstance(flow, Node) else 1e-9


@flows
@dims
@few
@given(seed=seeds, s=times, t=times)
def test_flow_is_a_one_parameter_group(
    options: dict[str, str], dim: int, seed: int, s: float, t: float
) -> None:
    flow = random_flow(options, dim, seed)
    if isinstance(flow, Node):
        flow.steps = 32
    keeps_the_group(flow, s, t, order_of(flow), seed)


@flows
@dims
def test_laws_hold_in_single_precision(options: dict[str, str], dim: int) -> None:
    flow = random_flow(options, dim, 3)
    x = points(flow, 50, 3, torch.float32)
    assert flow(x, 0.5).dtype == torch.float32
    assert gap(flow, flow(flow(x, 0.5), -0.5), x) < 3e-5
    assert gap(flow, flow(flow(x, 0.5), 0.5), flow(x, 1.0)) < 3e-5


@warps
@dims
@few
@given(seed=seeds)
def test_trajectory_is_repeated_forward(options: dict[str, str], dim: int, seed: int) -> None:
    flow = random_flow(options, dim, seed)
    x = points(flow, 10, seed)
    ts = [0.7, -0.3, 0.0, 1.0, 0.25, 0.25, -1.0]
    path = flow.trajectory(x, ts)
    assert path.shape == (7, 10, dim)
    for moved, t in zip(path, ts, strict=True):
        assert gap(flow, moved, flow(x, t)) < 1e-4


@warps
@dims
def test_one_time_a_point_is_the_same_as_one_for_all(options: dict[str, str], dim: int) -> None:
    flow = random_flow(options, dim, 5)
    x = points(flow, 6, 5)
    ts = torch.tensor([0.0, 0.5, -0.5, 1.0, -1.0, 0.5], dtype=torch.float64)
    together = flow(x, ts)
    for i, t in enumerate(ts.tolist()):
        assert gap(flow, together[i : i + 1], flow(x[i : i + 1], t)) < 1e-4


@warps
@dims
@few
@given(seed=seeds)
def test_jacobians_are_finite_differences(options: dict[str, str], dim: int, seed: int) -> None:
    differentiates_itself(random_flow(options, dim, seed), seed)


@warps
@dims
def test_velocity_is_the_rate_at_the_start(options: dict[str, str], dim: int) -> None:
    flow = random_flow(options, dim, 8)
    x = points(flow, 8, 8)
    h = 1e-6
    assert torch.allclose(flow.velocity(x), (flow(x, h) - flow(x, 0.0)) / h, atol=1e-4)


@warps
@dims
def test_saved_flow_answers_the_same(options: dict[str, str], dim: int) -> None:
    is_saved(random_flow(options, dim, 2))


def test_runge_kutta_has_fourth_order() -> None:
    flow = random_flow({"kind": "node", "field": "siren"}, 3, 1)
    assert isinstance(flow, Node)
    flow.field.base = SplineField(3)
    x = points(flow, 50, 1)
    errors = []
    for flow.steps in (64, 4, 8, 16):
        errors.append(flow(x, 1.0))
    coarse, middle, fine = (gap(flow, moved, errors[0]) for moved in errors[1:])
    assert 12 < coarse / middle < 20
    assert 12 < middle / fine < 20


def test_spline_field_turns_with_the_world() -> None:
    flow = random_flow({"kind": "node"}, 3, 4)
    assert isinstance(flow, Node)
    assert isinstance(flow.field, SplineField)
    turn = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64))[0]
    turned = SplineField(3)
    field = flow.field
    turned.set(field.centers @ turn.T, field.weights @ turn.T, field.affine @ turn.T)
    turned.affine[1:] = turn @ field.affine[1:] @ turn.T
    x = torch.rand(20, 3, dtype=torch.float64)
    assert torch.allclose(turned(x @ turn.T), field(x) @ turn.T, atol=1e-12)


def test_linear_moves_nothing() -> None:
    flow = make_flow("linear", 3)
    assert isinstance(flow, Linear)
    x = points(flow, 4, 0)
    assert torch.equal(flow(x, 0.7), x)
    assert not flow.velocity(x).any()


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"kind": "warp"}, "warp"),
        ({"kind": "node", "field": "grid"}, "grid"),
        ({"kind": "node", "fields": "siren"}, "fields"),
        ({"kind": "ncf", "activation": "relu"}, "relu"),
    ],
)
def test_a_misspelt_option_is_named(options: dict[str, str], named: str) -> None:
    with pytest.raises(OptionError, match=named):
        make_flow(**options)
