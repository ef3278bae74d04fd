"""Flows and their baselines: warps of space that a morph travels along."""

from __future__ import annotations

from typing import Any

from splatmorph.errors import OptionError
from splatmorph.flows.base import Flow
from splatmorph.flows.node import Node
from splatmorph.flows.spline import SplineField

__all__ = ["FIELDS", "KINDS", "Flow", "Node", "SplineField", "flow_from_config", "make_flow"]

FIELDS = ("spline",)
KINDS = ("node",)


def make_flow(kind: str = "node", dim: int = 3, **options: Any) -> Flow:
    """An unfitted flow in R^dim.

    ``kind`` is one of ``KINDS``; ``field``, for ``node`` only, one of ``FIELDS``.

    Raises ``OptionError`` on an unknown kind, field or option.
    """
    if kind not in KINDS:
        raise OptionError(f"flow '{kind}' is unknown: choose one of {', '.join(KINDS)}")
    steps = options.pop("steps", 8)
    name = options.pop("field", "spline")
    if name not in FIELDS:
        raise OptionError(f"field '{name}' is unknown: choose one of {', '.join(FIELDS)}")
    try:
        return Node(dim, SplineField(dim, **options), steps).requires_grad_(False)
    except TypeError as error:
        raise OptionError(f"flow '{kind}' does not take these options: {error}") from None


def flow_from_config(config: dict[str, Any]) -> Flow:
    """The flow that ``Flow.config`` described, ready for ``load_state_dict``."""
    return make_flow(**config)
