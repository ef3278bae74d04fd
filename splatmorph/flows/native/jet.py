# mypy: ignore-errors
# Warp's annotations are values, which a type checker can't read.
"""Networks and couplings with derivatives in C++, as differentiable functions of torch."""

from __future__ import annotations

import ctypes
from functools import cache
from itertools import combinations_with_replacement
from pathlib import Path

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from renderer.quietly import wp
from splatmorph.flows.jets import Jet, Pairs
from splatmorph.flows.native.threads import on_all_threads
from splatmorph.flows.network import Network

WORTH_SHARING = 1 << 21
"""Products in the middle layer from which a second thread pays."""

ARRAYS = (
    *("first", "first_bias", "second", "second_bias", "last", "last_bias"),
    *("pair", "from", "to", "kept", "slope_to", "slope_from", "slope_weights", "outer_pair"),
)
SIZES = (
    *("points", "inputs", "width", "outputs", "directions", "pairs"),
    *("outer_directions", "outer_pairs", "moved"),
)


class _Arguments(ctypes.Structure):
    """The twin of the one in ``jet.h``."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ARRAYS),
        *((name, ctypes.c_int64) for name in SIZES),
        *((name, ctypes.c_double) for name in ("first_omega", "omega", "bound")),
    )


@cache
def _kernel(what: str, way: str):
    sources = ["lanes", "jet", f"jet_{way}", f"{what}_{way}"]
    if what == "coupling":
        sources.insert(3, what)
    folder = Path(__file__).parent
    texts = [(folder / f"{source}.h").read_text(encoding="utf-8") for source in sources]

    @wp.func_native("\n".join(texts))
    def run_natively(arguments: wp.uint64, parts: int, part: int): ...

    @wp.kernel(enable_backward=False, module="unique")
    def run(arguments: wp.uint64, parts: int, part: int):
        run_natively(arguments, parts, part)

    return run


class _Jets(torch.autograd.Function):
    """A network or a coupling on the rows of a jet, differentiable once."""

    @staticmethod
    def forward(ctx, what: str, rows: Tensor, pairs: Tensor, scalars: tuple, *layers: Tensor):
        """``rows`` (channels, m, inputs or dim): value, derivatives, second ones along ``pairs``.

        ``layers``: matrix, bias, matrix, bias, matrix, bias. -> (channels, m, outputs or dim)
        """
        channels, m, columns = rows.shape
        width, inputs = layers[0].shape
        outputs = len(layers[-1])
        directions, inner, outer = channels - 1 - len(pairs), pairs, (0, 0)
        if what == "coupling":
            outer = directions, len(pairs)
            directions, inner = inputs, _every_pair(inputs if len(pairs) else 0)
        made = rows.new_empty(channels, m, outputs if what == "network" else columns)
        kept = None
        if any(ctx.needs_input_grad):
            kept = rows.new_empty(m, 1 + directions + len(inner), width)
        ctx.what, ctx.sizes = what, (m, inputs, width, outputs, directions, len(inner), *outer)
        ctx.scalars = scalars
        ctx.save_for_backward(rows, pairs, inner, kept, *layers)
        arrays = (*layers, inner, rows, made, kept, None, None, None, pairs)
        _run(what, "forward", arrays, ctx.sizes, scalars)
        return made

    @staticmethod
    @once_differentiable
    def backward(ctx, slope: Tensor):
        """∂loss/∂made -> ∂loss/∂(rows, layers)."""
        rows, pairs, inner, kept, *layers = ctx.saved_tensors
        parts = [layer.numel() for layer in layers]
        slope_rows = torch.empty_like(rows)
        slopes = rows.new_zeros(torch.get_num_threads(), sum(parts))
        slope = slope.contiguous()
        arrays = (*layers, inner, rows, None, kept, slope, slope_rows, slopes, pairs)
        _run(ctx.what, "backward", arrays, ctx.sizes, ctx.scalars)
        first, *others = slopes.sum(0).split(parts)
        first = first.view(-1, len(layers[0])).T
        others = (x.view_as(layer) for x, layer in zip(others, layers[1:], strict=True))
        return None, slope_rows, None, None, first, *others


def _run(what: str, way: str, arrays, sizes, scalars) -> None:
    addresses = (None if array is None else array.data_ptr() for array in arrays)
    arguments = _Arguments(*addresses, *sizes, *scalars)
    points, _, width, _, directions, pairs, *_ = sizes
    products = points * (1 + directions + pairs) * width**2
    parts = torch.get_num_threads() if products > WORTH_SHARING else 1
    on_all_threads(_kernel(what, way), [ctypes.addressof(arguments)], parts)


@cache
def _tensor(pairs: Pairs) -> Tensor:
    return torch.tensor(pairs, dtype=torch.int32).reshape(-1, 2)


def _every_pair(directions: int) -> Tensor:
    return _tensor(tuple(combinations_with_replacement(range(directions), 2)))


def push_network(jet: Jet, network: Network) -> Jet:
    """A jet through a network."""
    return _push("network", jet, network)


def push_coupling(jet: Jet, network: Network, moved: int, bound: float) -> Jet:
    """A jet through z_moved <- exp(bound·tanh r₀) z_moved + r₁, or with bound < 0 its inverse."""
    return _push("coupling", jet, network, moved, bound)


def _push(what: str, jet: Jet, network: Network, moved: int = 0, bound: float = 0.0) -> Jet:
    second = jet.second
    if jet.pairs and second is None:
        second = jet.value.new_zeros(len(jet.pairs), *jet.value.shape)
    rows = torch.cat([part for part in (jet.value[None], jet.first, second) if part is not None])
    layers = zip(network.weights, network.biases, strict=True)
    made = _Jets.apply(
        *(what, rows, _tensor(jet.pairs), (moved, *network.omegas, bound)),
        *(part for layer in layers for part in layer),
    )
    split = 1 + len(jet.first)
    return Jet(made[0], made[1:split], jet.pairs, made[split:] if jet.pairs else None)
