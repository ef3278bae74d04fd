"""The C++ jets against their plain twin, forward and in reverse."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from renderer.cpp import plain_twins
from splatmorph.flows.jets import Jet
from splatmorph.flows.native.jet import takes
from splatmorph.flows.ncf import NCF
from splatmorph.flows.network import Network

FEW, MANY = 33, 700
"""Points: not a whole number of registers, and enough for several threads."""


def drawn_jet(columns: int, directions: int, pairs: tuple[tuple[int, int], ...], count: int) -> Jet:
    generator = torch.Generator().manual_seed(directions)

    def draw(*shape: int) -> Tensor:
        return torch.randn(*shape, count, columns, generator=generator)

    return Jet(0.5 * draw(), draw(directions), pairs, draw(len(pairs)) if pairs else None)


def answers(push: Callable[[Jet], Jet], jet: Jet, module: torch.nn.Module) -> list[Tensor]:
    """What ``push`` makes, and the gradients of a drawn sum over it."""
    leaves = [tensor.clone() for tensor in (jet.value, jet.first, jet.second) if tensor is not None]
    for leaf in (*leaves, *module.parameters()):
        leaf.requires_grad_(True)
        leaf.grad = None
    second = leaves[2] if jet.pairs else None
    made = push(Jet(leaves[0], leaves[1], jet.pairs, second))
    outputs = [tensor for tensor in (made.value, made.first, made.second) if tensor is not None]
    generator = torch.Generator().manual_seed(0)
    weights = [torch.randn(output.shape, generator=generator) for output in outputs]
    sum((w * o).sum() for w, o in zip(weights, outputs, strict=True)).backward()
    slopes = [leaf.grad for leaf in (*leaves, *module.parameters())]
    assert all(slope is not None for slope in slopes)
    return [tensor.detach() for tensor in (*outputs, *slopes)]


def assert_native_is_plain(
    push: Callable[[Jet], Jet],
    jet: Jet,
    module: torch.nn.Module,
) -> None:
    native = answers(push, jet, module)
    with plain_twins():
        plain = answers(push, jet, module)
    for ours, theirs in zip(native, plain, strict=True):
        assert ours.shape == theirs.shape
        if theirs.numel():
            assert float((ours - theirs).abs().max()) < 2e-5 * float(theirs.abs().max())


JETS: dict[str, tuple[int, tuple[tuple[int, int], ...]]] = {
    "value": (0, ()),
    "tangent": (1, ()),
    "mixed": (2, ((0, 1),)),
    "whole": (3, ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))),
}


@pytest.mark.parametrize("count", [FEW, MANY])
@pytest.mark.parametrize("kind", JETS)
def test_network(kind: str, count: int) -> None:
    network = Network([4, 96, 96, 3], first_omega=10.0, omega=4.0)
    network.initialise(torch.Generator().manual_seed(1))
    jet = drawn_jet(4, *JETS[kind], count)
    assert takes("network", jet, network.layers())
    assert_native_is_plain(network.push, jet, network)


@pytest.mark.parametrize("kind", JETS)
def test_couplings_and_their_inverses(kind: str) -> None:
    flow = NCF(3, layers=4)
    flow.initialise(torch.Generator().manual_seed(1))
    jet = drawn_jet(3, *JETS[kind], FEW)
    for push in (flow._push, flow._push_inverse):
        assert_native_is_plain(push, jet, flow.couplings)


def test_couplings_of_the_plane() -> None:
    flow = NCF(2, layers=6)
    flow.initialise(torch.Generator().manual_seed(1))
    jet = drawn_jet(2, 2, ((0, 0), (0, 1), (1, 1)), MANY)
    for push in (flow._push, flow._push_inverse):
        assert_native_is_plain(push, jet, flow.couplings)


def test_threads_change_no_bit_of_the_values() -> None:
    network = Network([3, 64, 64, 3])
    network.initialise(torch.Generator().manual_seed(1))
    jet = drawn_jet(3, *JETS["whole"], MANY)
    threads = torch.get_num_threads()
    try:
        made = []
        for count in (1, 3):
            torch.set_num_threads(count)
            made.append(network.push(jet))
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(made[0].value, made[1].value)
    assert torch.equal(made[0].hessian(), made[1].hessian())


def test_other_networks_stay_with_torch() -> None:
    jet = drawn_jet(3, *JETS["mixed"], FEW)
    assert not takes("network", jet, Network([3, 64, 64, 64, 3]).layers())
    assert not takes("network", jet, Network([3, 50, 50, 3]).layers())
    assert not takes("network", jet, Network([3, 64, 64, 3], activation="sigmoid").layers())
    assert not takes("network", jet, Network([3, 64, 64, 3]).double().layers())
