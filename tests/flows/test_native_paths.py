"""The C++ paths against their plain twin."""

from __future__ import annotations

import pytest
import torch
from flow_cases import points, random_flow

from renderer.cpp import FEWEST, plain_twins
from splatmorph.flows import Node


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("field", ["spline", "siren"])
def test_native_paths_are_the_plain_ones(field: str, dim: int) -> None:
    flow = random_flow({"kind": "node", "field": field}, dim, 3)
    assert isinstance(flow, Node)
    x = points(flow, FEWEST + 5, 3, torch.float32)
    times = [0.4, -0.9, 1.0, 0.0]
    native = *flow.trajectory_jacobian(x, times), flow.trajectory(x, times), flow(x, 0.7)
    with plain_twins():
        plain = *flow.trajectory_jacobian(x, times), flow.trajectory(x, times), flow(x, 0.7)
    for ours, theirs in zip(native, plain, strict=True):
        assert torch.allclose(ours, theirs, atol=1e-4)
    assert torch.equal(native[2][3], x)


@pytest.mark.parametrize("sign", [1, -1])
def test_what_is_kept_of_a_path_is_what_lies_on_it(sign: int) -> None:
    """Times a whole number of steps apart, of which nothing else is kept, beside others."""
    flow = random_flow({"kind": "node"}, 3, 2)
    x = points(flow, FEWEST + 5, 3, torch.float32)
    times = [sign * k / 8 for k in range(1, 9)]
    even = flow.trajectory_jacobian(x, times)
    among_others = flow.trajectory_jacobian(x, [*times, 0.3])
    for ours, theirs in zip(even, among_others, strict=True):
        torch.testing.assert_close(ours, theirs[:-1], atol=1e-6, rtol=1e-6)


def test_native_paths_are_the_same_on_any_number_of_threads() -> None:
    flow = random_flow({"kind": "node"}, 3, 1)
    x = points(flow, 3001, 1, torch.float32)
    threads = torch.get_num_threads()
    try:
        answers = []
        for count in (1, 2, 3):
            torch.set_num_threads(count)
            answers.append(flow.trajectory(x, [0.3, 1.0]))
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(answers[0], answers[1])
    assert torch.equal(answers[0], answers[2])
