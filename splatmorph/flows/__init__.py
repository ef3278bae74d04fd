"""Flows and their baselines: warps of space that a morph travels along, a module each."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from typing import Any

from splatmorph.errors import OptionError
from splatmorph.flows.base import KINDS, Flow
from splatmorph.flows.ifmorph import Ifmorph
from splatmorph.flows.linear import Linear
from splatmorph.flows.ncf import NCF
from splatmorph.flows.node import FIELDS, Node
from splatmorph.flows.siren import SirenField
from splatmorph.flows.spline import SplineField
from splatmorph.flows.thin_plate import ThinPlate

__all__ = [
    "FIELDS",
    "KINDS",
    "NCF",
    "Flow",
    "Ifmorph",
    "Linear",
    "Node",
    "SirenField",
    "SplineField",
    "ThinPlate",
    "flow_from_config",
    "make_flow",
]

# Every module here, so that a flow is known by lying in this folder.
for _module in pkgutil.iter_modules(__path__, f"{__name__}."):
    importlib.import_module(_module.name)


def make_flow(kind: str = Node.kind, dim: int = 3, **options: Any) -> Flow:
    """An unfitted flow in R^dim.

    ``kind`` is one of ``KINDS``: node and ncf are flows; ifmorph, tps and linear the baselines. A
    flow of one's own is among them once its class is defined. ``node`` takes ``field``, one of
    ``FIELDS`` (default "spline"), and ``steps``; every other option belongs to the field or flow
    and is documented there.

    >>> import torch
    >>> flow, points = make_flow("node", dim=3), torch.rand(5, 3, dtype=torch.float64)
    >>> torch.equal(flow(points, 0.0), points)
    True

    Raises:
        OptionError: an unknown kind, field or option.
    """
    if kind not in KINDS:
        raise OptionError(f"flow '{kind}' is unknown: choose one of {', '.join(sorted(KINDS))}")
    return KINDS[kind].make(dim, **options).requires_grad_(False)


def flow_from_config(config: Mapping[str, Any]) -> Flow:
    """The flow that ``Flow.config`` described, ready for ``load_state_dict``.

    Raises:
        OptionError: see :func:`make_flow`.
    """
    return make_flow(**config)
