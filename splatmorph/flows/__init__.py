"""Flows and their baselines: warps of space that a morph travels along."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from splatmorph.errors import OptionError
from splatmorph.flows.base import Flow
from splatmorph.flows.conjugate import Conjugate
from splatmorph.flows.displacement import Displacement, Still
from splatmorph.flows.ifmorph import Ifmorph
from splatmorph.flows.node import DEFAULT_STEPS, Node
from splatmorph.flows.siren import SirenField
from splatmorph.flows.spline import SplineField

__all__ = [
    "FIELDS",
    "KINDS",
    "Conjugate",
    "Displacement",
    "Flow",
    "Ifmorph",
    "Node",
    "SirenField",
    "SplineField",
    "Still",
    "flow_from_config",
    "make_flow",
]

FIELDS: Mapping[str, type[SplineField | SirenField]] = {
    field.name: field for field in (SplineField, SirenField)
}
"""The velocity fields that the node flow integrates."""

_OTHERS: Mapping[str, type[Flow]] = {
    flow.kind: flow for flow in (Conjugate, Ifmorph, Displacement, Still)
}
KINDS = (Node.kind, *_OTHERS)
"""node and ncf are flows; ifmorph, tps and linear are the baselines."""


def make_flow(kind: str = Node.kind, dim: int = 3, **options: Any) -> Flow:
    """An unfitted flow in R^dim.

    ``kind`` is one of ``KINDS``. ``node`` takes ``field``, one of ``FIELDS`` (default "spline"),
    and ``steps``; every other option belongs to the field or flow and is documented there.

    Raises ``OptionError`` on an unknown kind, field or option.
    """
    if kind not in KINDS:
        raise OptionError(f"flow '{kind}' is unknown: choose one of {', '.join(KINDS)}")
    try:
        if kind != Node.kind:
            return _OTHERS[kind](dim, **options).requires_grad_(False)
        steps = options.pop("steps", DEFAULT_STEPS)
        name = options.pop("field", SplineField.name)
        if name not in FIELDS:
            raise OptionError(f"field '{name}' is unknown: choose one of {', '.join(FIELDS)}")
        return Node(dim, FIELDS[name](dim, **options), steps).requires_grad_(False)
    except TypeError as error:
        taken = str(error).split("__init__() ")[-1]
        raise OptionError(f"flow '{kind}' {taken}") from None


def flow_from_config(config: Mapping[str, Any]) -> Flow:
    """The flow that ``Flow.config`` described, ready for ``load_state_dict``."""
    return make_flow(**config)
