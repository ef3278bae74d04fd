"""Networks and couplings with derivatives in C++, as differentiable functions of torch."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache, reduce
from itertools import accumulate, combinations_with_replacement
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from renderer.snippet import run_snippet
from splatmorph.flows.jets import Jet, Pairs
from splatmorph.flows.network import Network

WORTH_SHARING = 1 << 22
"""Products in the middle layers from which a second thread pays."""


Scalars = tuple[int, float, float, float]
"""The coordinate that a coupling moves, ω of the first and of the second layer, and the bound."""


class _Arguments(ctypes.Structure):
    """The twin of the one in ``jet.h``."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("first", "first_bias", "second", "second_bias")),
        *((name, ctypes.c_void_p) for name in ("last", "last_bias", "from", "to")),
        *((name, ctypes.c_void_p) for name in ("slope_to", "slope_from", "slope_weights")),
        *((name, ctypes.c_int64) for name in ("layers", "points", "width", "parameters", "moved")),
        *((name, ctypes.c_double) for name in ("first_omega", "omega", "bound")),
    )


@cache
def _source(what: str, way: str, inputs: int, outputs: int, directions: int, pairs: Pairs) -> str:
    """``way`` forward or backward, for jets with so many ``directions`` and these ``pairs``."""
    constants, headers = "", ["lanes.h", "jet.h", f"{what}_{way}.h"]
    if way == "backward":
        headers.insert(2, "jet_backward.h")
    if what == "coupling":
        headers.insert(-1, "coupling.h")
        constants = _constants("OUTER_", directions, pairs)
        inner = tuple(combinations_with_replacement(range(inputs), 2)) if pairs else ()
        directions, pairs = inputs, inner
    constants += f"constexpr int INPUTS = {inputs}, OUTPUTS = {outputs};\n"
    constants += _constants("", directions, pairs)
    folder = Path(__file__).parent
    return constants + "\n".join((folder / name).read_text(encoding="utf-8") for name in headers)


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
        scalars: list[Scalars],
        *layers: Tensor,
    ) -> Tensor:
        """``rows`` (channels, m, inputs or dim): value, derivatives, second ones along ``pairs``.

        ``layers``: of each the matrix,
        bias, matrix, bias, matrix, bias. -> (channels, m, outputs or dim)
        """
        channels, m, columns = rows.shape
        width, inputs = layers[0].shape
        outputs, count = len(layers[5]), len(scalars)
        made = rows.new_empty(count, channels, m, columns if what == "coupling" else outputs)
        given = [rows, *made[:-1]]
        ctx.sizes = (count, m, width, sum(layer.numel() for layer in layers))
        ctx.shape = (inputs, outputs, channels - 1 - len(pairs), pairs)
        ctx.what, ctx.scalars = what, scalars
        ctx.save_for_backward(*given, *layers)
        arguments = [
            _Arguments(
                *_addresses(layers, i, given[i], made[i]), None, None, None, *ctx.sizes, *own
            )
            for i, own in enumerate(scalars)
        ]
        parts = _parts(count, channels * m, layers[0])
        _run(_source(what, "forward", *ctx.shape), arguments, parts)
        return made[-1]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        """∂loss/∂made -> ∂loss/∂(rows, layers)."""
        count = len(ctx.scalars)
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
            addresses = (*_addresses(layers, i, given[i], None), *(a.data_ptr() for a in arrays))
            arguments.append(_Arguments(*addresses, *ctx.sizes, *ctx.scalars[i]))
        _run(_source(ctx.what, "backward", *ctx.shape), arguments, parts)
        summed = reduce(torch.add, slopes)  # torch's own sum would wake threads for so many
        slopes_of_layers = [
            part.view(layer.T.shape).T if i % 6 == 0 else part.view(layer.shape)
            for i, (part, layer) in enumerate(zip(summed.split(sizes), layers, strict=True))
        ]
        return None, slope_given[0], None, None, *slopes_of_layers


def _addresses(
    layers: Sequence[Tensor], i: int, given: Tensor, made: Tensor | None
) -> list[int | None]:
    tensors = [*layers[6 * i : 6 * i + 6], given, made]
    return [None if tensor is None else tensor.data_ptr() for tensor in tensors]


def _parts(count: int, rows: int, first: Tensor) -> int:
    products = count * rows * len(first) ** 2
    return torch.get_num_threads() if products > WORTH_SHARING else 1


def _run(source: str, arguments: list[_Arguments], parts: int) -> None:
    run_snippet(source, (_Arguments * len(arguments))(*arguments), parts)


def push_network(jet: Jet, network: Network) -> Jet:
    """A jet through a network."""
    return _push("network", jet, [network], [(0, *_omegas(network), 0.0)])


def push_couplings(jet: Jet, couplings: Sequence[tuple[Network, int, float]]) -> Jet:
    """A jet through z_moved <- exp(bound·tanh r₀) z_moved + r₁, one after the other.

    ``couplings``: of each the network that makes r, ``moved`` and ``bound``; bound < 0 asks for
    the inverse of the coupling with the bound -bound.
    """
    networks = [network for network, *_ in couplings]
    scalars = [(moved, *_omegas(network), bound) for network, moved, bound in couplings]
    return _push("coupling", jet, networks, scalars)


def _omegas(network: Network) -> tuple[float, float]:
    first, second = network.omegas
    return first, second


def _push(what: str, jet: Jet, networks: list[Network], scalars: list[Scalars]) -> Jet:
    second = jet.second
    if jet.pairs and second is None:
        second = jet.value.new_zeros(len(jet.pairs), *jet.value.shape)
    rows = torch.cat([part for part in (jet.value[None], jet.first, second) if part is not None])
    layers = [
        part
        for network in networks
        for layer in zip(network.weights, network.biases, strict=True)
        for part in layer
    ]
    made = _Jets.apply(what, rows, jet.pairs, scalars, *layers)
    split = 1 + len(jet.first)
    return Jet(made[0], made[1:split], jet.pairs, made[split:] if jet.pairs else None)
