"""splatmorph: morph one 3D Gaussian splat into another, by flows.

import splatmorph as sm

run = sm.fit_run("a.ply", "b.ply", out="a-b.run")
for splat in run.morph().sequence([0.25, 0.5, 0.75]):
    ...
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from splatmorph._later import later
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

__getattr__, __dir__ = later(__name__, _HOMES)
