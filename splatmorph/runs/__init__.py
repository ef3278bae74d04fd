"""Runs: what a user asks for, its inputs, the directory that a fit leaves, and what is exported."""

from splatmorph.runs.finding import Finding
from splatmorph.runs.inputs import Input, load_input
from splatmorph.runs.posing import Posing
from splatmorph.runs.request import Fitting, Request, fit_run
from splatmorph.runs.run import Run, load_run, open_run

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
