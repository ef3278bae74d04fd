"""Runs: what a user asks for, its inputs, the directory that a fit leaves, and what is exported."""

from __future__ import annotations

from typing import TYPE_CHECKING

from splatmorph._later import later
from splatmorph.runs.settings import Finding, Fitting, Posing

if TYPE_CHECKING:
    from splatmorph.runs.inputs import Input, load_input
    from splatmorph.runs.request import Request, fit_run
    from splatmorph.runs.run import Run, load_run, open_run

_HOMES = {
    "Input": "inputs",
    "Request": "request",
    "Run": "run",
    "fit_run": "request",
    "load_input": "inputs",
    "load_run": "run",
    "open_run": "run",
}

__all__ = [
    "Finding",
    "Fitting",
    "Input",
    "Posing",
    "Request",
    "Run",
    "fit_run",
    "load_input",
    "load_run",
    "open_run",
]

__getattr__, __dir__ = later(__name__, _HOMES)
