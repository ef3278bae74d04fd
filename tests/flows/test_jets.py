"""Forward differentiation against autograd and finite differences, in double precision."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from splatmorph.flows import NCF, make_flow
from splatmorph.flows.jets import Jet
from splatmorph.flows.network import ACTIVATIONS, Network


def derivatives(f: Callable[[Tensor], Tensor], x: Tensor) -> tuple[Tensor, Tensor]:
    """Jacobians (m, k, n) and Hessians (m, k, n, n) of f at every point, by autograd."""
    x = x.clone().requires_grad_(True)
    first = slopes(f(x), x)
    second = torch.stack([slopes(first[:, i], x) for i in range(first.shape[1])], 1)
    return first.detach(), second.detach()


def slopes(y: Tensor, x: Tensor) -> Tensor:
    columns = [
        torch.autograd.grad(y[:, i].sum(), x, create_graph=True, allow_unused=True)[0]
        for i in range(y.shape[1])
    ]
    return torch.stack([torch.zeros_like(x) if c is None else c for c in columns], 1)


def drawn(module: Network, seed: int = 0) -> Network:
    module.initialise(torch.Generator().manual_seed(seed))
    return module.double().requires_grad_(False)


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("dim", [2, 3])
def test_network_jet_is_autograd(activation: str, dim: int) -> None:
    network = drawn(Network([dim, 16, 16, 4], activation=activation))
    x = torch.rand(5, dim, dtype=torch.float64)
    jet = network.push(Jet.seed(x))
    first, second = derivatives(network, x)
    assert torch.allclose(jet.value, network(x))
    assert torch.allclose(jet.jacobian(), first)
    assert torch.allclose(jet.hessian(), second, rtol=1e-8, atol=1e-8)


def test_directional_jet_is_a_part_of_the_full_one() -> None:
    network = drawn(Network([3, 16, 16, 3]))
    x, e, f = torch.rand(3, 7, 3, dtype=torch.float64)
    whole = network.push(Jet.seed(x))
    jet = network.push(Jet(x, torch.stack([e, f]), ((0, 1),)))
    assert jet.second is not None
    assert torch.allclose(jet.first[0], torch.einsum("mij,mj->mi", whole.jacobian(), e))
    mixed = torch.einsum("mijk,mj,mk->mi", whole.hessian(), e, f)
    assert torch.allclose(jet.second[0], mixed)


def test_product_obeys_leibniz() -> None:
    a, b = drawn(Network([2, 8, 3]), 1), drawn(Network([2, 8, 3]), 2)
    x = torch.rand(4, 2, dtype=torch.float64)
    jet = a.push(Jet.seed(x)) * b.push(Jet.seed(x))
    first, second = derivatives(lambda y: a(y) * b(y), x)
    assert torch.allclose(jet.jacobian(), first)
    assert torch.allclose(jet.hessian(), second)


@pytest.mark.parametrize("dim", [2, 3])
def test_conjugate_flow_jets_are_autograd(dim: int) -> None:
    flow = make_flow("ncf", dim, width=8, layers=4).double()
    assert isinstance(flow, NCF)
    generator = torch.Generator().manual_seed(1)
    flow.initialise(generator)
    flow.generator.copy_(0.5 * torch.randn(dim, dim, generator=generator))
    flow.drift.fill_(0.3)
    x = torch.rand(5, dim, dtype=torch.float64) - 0.5
    first, second = derivatives(lambda y: flow.unit_forward(y, 0.7), x)
    assert torch.allclose(flow.jacobian(x, 0.7), first)
    assert torch.allclose(flow.unit_hessian(x, 0.7), second, atol=1e-8)
    slope, _ = derivatives(flow.unit_velocity, x)
    assert torch.allclose(flow.unit_velocity_jacobian(x), slope, atol=1e-8)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("field", ["spline", "siren"])
def test_field_derivatives_are_autograd(field: str, dim: int) -> None:
    flow = make_flow("node", dim, field=field)
    spline = flow.field if field == "spline" else flow.field.base
    generator = torch.Generator().manual_seed(2)
    spline.set(
        torch.rand(6, dim, generator=generator) - 0.5,
        torch.randn(6, dim, generator=generator),
        torch.randn(dim + 1, dim, generator=generator),
    )
    if field == "siren":
        flow.field.network.initialise(generator)
    x = torch.rand(4, dim, dtype=torch.float64) + 0.6
    x.requires_grad_(True)
    first = flow.field.jacobian(x)
    assert torch.allclose(first, slopes(flow.field(x), x))
    second = torch.stack([slopes(first[:, i], x) for i in range(dim)], 1)
    assert torch.allclose(flow.field.hessian(x), second, atol=1e-9)
