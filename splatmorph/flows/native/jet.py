"""Networks and couplings with derivatives in C++, as differentiable functions of torch."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache, reduce
from itertools import accumulate, combinations_with_replacement
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from renderer.cpp import Program
from splatmorph.flows.jets import Jet, Pairs

WIDTHS = range(32, 257, 32)
"""Of the networks that ``jet.h`` knows."""
MOST_INPUTS = 8
MOST_CHANNELS = 10
WORTH_SHARING = 1 << 22
"""Products in the middle layers from which a second thread pays."""
PARTS = 4
"""Then, whatever the cores: slopes are summed by part, and so rounded by their number."""


class Layers(NamedTuple):
    """A network's linear maps, and the ω of the activations between them."""

    activation: str
    weights: nn.ParameterList
    biases: nn.ParameterList
    omegas: Sequence[float]


class Step(NamedTuple):
    """A network, or the coupling that it makes."""

    layers: Layers
    moved: int = 0
    """The coordinate i of z_i <- exp(bound·tanh r₀) z_i + r₁."""
    bound: float = 0.0
    """Below 0 it asks for the inverse of the coupling with the bound -bound."""
    turn: Tensor | None = None
    """(dim, dim) what z is multiplied by before."""


class _Arguments(ctypes.Structure):
    """The twin of the one in ``jet.h``."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("first", "first_bias", "second", "second_bias")),
        *((name, ctypes.c_void_p) for name in ("last", "last_bias", "from", "to")),
        *((name, ctypes.c_void_p) for name in ("turn", "slope_to", "slope_from", "slope_weights")),
        *((name, ctypes.c_int64) for name in ("points", "width", "parameters", "moved")),
        *((name, ctypes.c_double) for name in ("first_omega", "omega", "bound")),
    )


Shape = tuple[int, int, int, Pairs]
"""A network's inputs and outputs, a jet's directions and pairs."""


@cache
def _program(what: str, way: str, shape: Shape) -> Program:
    """Of a network or a coupling, forward or backward."""
    inputs, outputs, directions, pairs = shape
    constants, headers = "", ["lanes.h", "jet.h", f"{what}_{way}.h"]
    if way == "backward":
        headers.insert(2, "jet_backward.h")
    if what == "coupling":
        headers.insert(-1, "coupling.h")
        constants = _constants("OUTER_", directions, pairs)
        inner = tuple(combinations_with_replacement(range(inputs), 2)) if pairs else ()
        directions, pairs = (inputs if directions else 0), inner
    constants += f"constexpr int INPUTS = {inputs}, OUTPUTS = {outputs};\n"
    constants += f"constexpr int MOST_WIDTH = {WIDTHS[-1]};\n"
    constants += _constants("", directions, pairs)
    return Program(
        Path(__file__).parent, headers, _Arguments, constants=constants, differentiable=True
    )


def takes(what: str, jet: Jet, layers: Layers) -> bool:
    """Whether a network of these layers, or a coupling of it, is for the functions below."""
    first = layers.weights[0]
    width, inputs = first.shape
    if not (
        layers.activation == "sine"
        and first.dtype == jet.value.dtype
        and len(layers.weights) == 3
        and width in WIDTHS
        and max(inputs, jet.value.shape[1]) <= MOST_INPUTS
        and 1 + len(jet.first) + len(jet.pairs) <= MOST_CHANNELS
    ):
        return False
    shape = (inputs, len(layers.weights[2]), len(jet.first), jet.pairs)
    ways = ("forward", "backward") if torch.is_grad_enabled() else ("forward",)
    return all(_program(what, way, shape).takes(jet.value, first, fewest=0) for way in ways)


def _constants(prefix: str, directions: int, pairs: Pairs) -> str:
    numbers = ", ".join(str(direction) for pair in pairs for direction in pair) or "0"
    return (
        f"constexpr int {prefix}DIRECTIONS = {directions}, {prefix}PAIRS = {len(pairs)};\n"
        f"constexpr int {prefix}PAIR[] = {{{numbers}}};\n"
    )


class _Jets(torch.autograd.Function):
    """A network, or couplings one after the other, on the rows of a jet; differentiable once."""

    @staticmethod
    def forward(
        ctx: Any,
        what: str,
        rows: Tensor,
        pairs: Pairs,
        steps: list[Step],
        *layers: Tensor,
    ) -> Tensor:
        """``rows`` (channels, m, inputs or dim): value, derivatives, second ones along ``pairs``.

        ``layers``: of each step the matrix, bias, matrix, bias, matrix, bias.
        -> (channels, m, outputs or dim)
        """
        channels, m, columns = rows.shape
        width, inputs = layers[0].shape
        outputs, count = len(layers[5]), len(steps)
        made = rows.new_empty(count, channels, m, columns if what == "coupling" else outputs)
        given = [rows, *made[:-1]]
        ctx.sizes = (m, width, sum(layer.numel() for layer in layers))
        ctx.shape = inputs, outputs, channels - 1 - len(pairs), pairs
        ctx.what, ctx.steps = what, steps
        ctx.save_for_backward(*given, *layers)
        arguments = [
            _arguments(step, layers[6 * i :], given[i], made[i], (None, None, None), ctx.sizes)
            for i, step in enumerate(steps)
        ]
        parts = _parts(count, channels * m, layers[0])
        _program(what, "forward", ctx.shape).run(arguments, parts)
        return made[-1]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        """∂loss/∂made -> ∂loss/∂(rows, layers)."""
        count = len(ctx.steps)
        given, layers = ctx.saved_tensors[:count], ctx.saved_tensors[count:]
        sizes = [layer.numel() for layer in layers]
        starts = list(accumulate(sizes, initial=0))
        parts = _parts(count, slope[..., 0].numel(), layers[0])
        slopes = slope.new_empty(parts, starts[-1])
        slope_given = [torch.empty_like(rows) for rows in given]
        slope_made = [*slope_given[1:], slope.contiguous()]
        arguments = []
        for i in reversed(range(count)):
            arrays = (slope_made[i], slope_given[i], slopes[0, starts[6 * i] :])
            step = ctx.steps[i]
            arguments.append(_arguments(step, layers[6 * i :], given[i], None, arrays, ctx.sizes))
        _program(ctx.what, "backward", ctx.shape).run(arguments, parts)
        summed = reduce(torch.add, slopes)  # torch's own sum would wake threads for so many
        slopes_of_layers = [
            part.view(layer.T.shape).T if i % 6 == 0 else part.view(layer.shape)
            for i, (part, layer) in enumerate(zip(summed.split(sizes), layers, strict=True))
        ]
        return None, slope_given[0], None, None, *slopes_of_layers


def _arguments(
    step: Step,
    layers: Sequence[Tensor],
    given: Tensor,
    made: Tensor | None,
    slopes: tuple[Tensor | None, ...],
    sizes: tuple[int, ...],
) -> _Arguments:
    tensors = (*layers[:6], given, made, step.turn, *slopes)
    addresses = (None if tensor is None else tensor.data_ptr() for tensor in tensors)
    return _Arguments(*addresses, *sizes, step.moved, *step.layers.omegas, step.bound)


def _parts(count: int, rows: int, first: Tensor) -> int:
    products = count * rows * len(first) ** 2
    return PARTS if products > WORTH_SHARING else 1


def push_network(jet: Jet, layers: Layers) -> Jet:
    """A jet through a network."""
    return _push("network", jet, [Step(layers)])


def push_couplings(jet: Jet, steps: list[Step]) -> Jet:
    """A jet through couplings, one after the other."""
    return _push("coupling", jet, steps)


def _push(what: str, jet: Jet, steps: list[Step]) -> Jet:
    second = jet.second
    if jet.pairs and second is None:
        second = jet.value.new_zeros(len(jet.pairs), *jet.value.shape)
    rows = torch.cat([part for part in (jet.value[None], jet.first, second) if part is not None])
    layers = [
        part
        for step in steps
        for layer in zip(step.layers.weights, step.layers.biases, strict=True)
        for part in layer
    ]
    made = _Jets.apply(what, rows, jet.pairs, steps, *layers)
    split = 1 + len(jet.first)
    return Jet(made[0], made[1:split], jet.pairs, made[split:] if jet.pairs else None)
