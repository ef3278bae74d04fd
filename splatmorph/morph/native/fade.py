"""``fade.h``: opacities and scales under the ramp ``calibrated``."""

from __future__ import annotations

import ctypes
from pathlib import Path

import torch
from torch import Tensor

from renderer.cpp import Program


class _Arguments(ctypes.Structure):
    """The twin of the one in ``fade.h``."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("logits", "log_scales", "weights", "table")),
        *((name, ctypes.c_void_p) for name in ("logits_out", "log_scales_out")),
        ("count", ctypes.c_int64),
    )


class Fade:
    """The ramp in C++.

    Arguments:
        steps: intervals of opacity in the tables, over 0 … ``densest``.
        weights: intervals of weight in a table for weights of their own, which has those within.
        densest: the most opaque that splats are drawn.
        faintest: the least.
    """

    def __init__(self, steps: int, weights: int, densest: float, faintest: float) -> None:
        constants = (
            f"constexpr int STEPS = {steps}, WEIGHTS = {weights};\n"
            f"constexpr float DENSEST = {densest:.9e}f, FAINTEST = {faintest:.9e}f;\n"
        )
        here = Path(__file__).parent
        self._program = Program(here, ("fade.h",), _Arguments, constants=constants)

    def takes(self, logits: Tensor, log_scales: Tensor) -> bool:
        """Whether these splats are for it."""
        return log_scales.dtype == logits.dtype and self._program.takes(logits, log_scales)

    def __call__(
        self,
        logits: Tensor,
        log_scales: Tensor,
        table: Tensor,
        weights: Tensor | None = None,
        out: tuple[Tensor, Tensor] | None = None,
    ) -> tuple[Tensor, Tensor]:
        """As its plain twin, on all of torch's threads; for what it ``takes``.

        Arguments:
            logits, log_scales: (n,) and (n, 3).
            table: (steps + 1, 3) for one weight, or (weights - 1, steps + 1, 3).
            weights: (n,) with the latter.
            out: where to write what is returned; ``log_scales`` themselves may be among it.
        """
        inputs = [logits.contiguous(), log_scales.contiguous()]
        if weights is not None:
            weights = weights.to(logits).contiguous()
        table = table.to(logits).contiguous()
        faded = out or (torch.empty_like(inputs[0]), torch.empty_like(inputs[1]))
        arguments = _Arguments(
            *(tensor.data_ptr() for tensor in inputs),
            None if weights is None else weights.data_ptr(),
            *(tensor.data_ptr() for tensor in (table, *faded)),
            len(logits),
        )
        self._program.run(arguments, torch.get_num_threads())
        return faded
