"""Memory that frames are made in, used again once nobody holds what was in it."""

from __future__ import annotations

import weakref
from itertools import accumulate

import numpy as np
import torch
from torch import Tensor

from splatmorph.gaussians import Gaussians

WIDTHS = {"means": 3, "quats": 4, "log_scales": 3, "opacity_logits": 1}
"""Floats a splat, but for the colours."""


class Memory:
    """Where frames of one length are made.

    The system hands out and takes back the megabytes of a frame a page at a time, which costs
    more than filling them. A frame that somebody holds keeps its own.
    """

    def __init__(self) -> None:
        self._free: dict[int, list[np.ndarray]] = {}

    @staticmethod
    def holds(gaussians: Gaussians) -> bool:
        """Whether splats are of the kind that it has room for, and want no gradient."""
        fields = (getattr(gaussians, name) for name in (*WIDTHS, "sh"))
        return all(
            field.dtype == torch.float32 and field.device.type == "cpu" and not field.requires_grad
            for field in fields
        )

    def splats(self, count: int, degree: int) -> Gaussians:
        """So many splats of any values, float32 on the CPU."""
        widths = [*WIDTHS.values(), 3 * (degree + 1) ** 2]
        ends = list(accumulate(count * width for width in widths))
        pieces = self._lend(ends[-1]).tensor_split(ends[:-1])
        means, quats, log_scales, opacity_logits, sh = pieces
        return Gaussians(
            means.view(count, 3),
            quats.view(count, 4),
            log_scales.view(count, 3),
            opacity_logits,
            sh.view(count, -1, 3),
        )

    def _lend(self, size: int) -> Tensor:
        free = self._free.setdefault(size, [])
        held = free.pop() if free else np.empty(size, np.float32)
        lent = held.view()
        # The tensor keeps what is lent alive, and what is lent the memory.
        weakref.finalize(lent, free.append, held).atexit = False
        return torch.from_numpy(lent)
