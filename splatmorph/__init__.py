"""splatmorph: morph one 3D Gaussian splat into another, by flows.

import splatmorph as sm

run = sm.fit_run("a.ply", "b.ply", out="a-b.run")
for splat in run.morph().sequence([0.25, 0.5, 0.75]):
    ...
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from splatmorph._version import __version__
from splatmorph.errors import SplatmorphError

if TYPE_CHECKING:
    from splatmorph.fitting import FitConfig, FitReport, fit
    from splatmorph.flows import Flow, make_flow
    from splatmorph.gaussians import Gaussians
    from splatmorph.io import read, write
    from splatmorph.landmarks import Landmarks
    from splatmorph.metrics import evaluate
    from splatmorph.morph import Chain, Morph
    from splatmorph.registration import correspond
    from splatmorph.rendering import render
    from splatmorph.runs import (
        Finding,
        Fitting,
        Posing,
        Run,
        fit_run,
        load_input,
        load_run,
        open_run,
    )

# Loaded when first asked for: torch takes a second, and `splatmorph --help` needs none of it.
_HOMES = {
    "Chain": "morph",
    "Finding": "runs",
    "FitConfig": "fitting",
    "FitReport": "fitting",
    "Fitting": "runs",
    "Flow": "flows",
    "Gaussians": "gaussians",
    "Landmarks": "landmarks",
    "Morph": "morph",
    "Posing": "runs",
    "Run": "runs",
    "correspond": "registration",
    "evaluate": "metrics",
    "fit": "fitting",
    "fit_run": "runs",
    "load_input": "runs",
    "load_run": "runs",
    "make_flow": "flows",
    "open_run": "runs",
    "read": "io",
    "render": "rendering",
    "write": "io",
}

__all__ = ["SplatmorphError", "__version__", *_HOMES]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'splatmorph' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"splatmorph.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
