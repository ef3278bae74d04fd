"""The run directory: what a fit leaves behind, and all that later commands need.

morph.json         the inputs (path, sha256, how they were posed), landmarks, options, versions
flow.safetensors   the flows' weights and frames
history.csv        the fit, step by step
report.json        what the fit achieved
state_N.safetensors  only where a fit was interrupted: what it goes on from, by leg
"""

from __future__ import annotations

import csv
import dataclasses
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save
from torch import Tensor

from splatmorph._version import __version__
from splatmorph.errors import OptionError, ReadError, RunError, SplatmorphError
from splatmorph.fitting import FitReport
from splatmorph.flows import Flow, flow_from_config
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.similarity import Similarity
from splatmorph.io.atomic import atomic_write, make_folder, write_json
from splatmorph.io.reading import read_json, reading
from splatmorph.landmarks import Landmarks
from splatmorph.morph import Morph
from splatmorph.morph.chain import Chain, average
from splatmorph.runs.inputs import Input, fingerprint, load_splat
from splatmorph.runs.state import drop_states, has_state

FORMAT = 2
SIDES = ("source", "target")
MOST_STEPS = 10_000
"""Integers of a flow's options that are no sizes are below this."""
PROBES = 64
"""Landmarks that a flow which is read has to carry somewhere."""
MANIFEST, WEIGHTS, HISTORY, REPORT = "morph.json", "flow.safetensors", "history.csv", "report.json"


@dataclass(frozen=True)
class Source:
    """An input as a run remembers it."""

    name: str
    """A short name for files and titles."""
    path: Path
    sha256: str
    options: Mapping[str, Any]
    """How an avatar was posed; empty for a plain splat."""


@dataclass(frozen=True)
class Leg:
    """One fitted flow of a run, from one input's landmarks to another's."""

    flow: Flow
    """Fitted in the source's place."""
    frame: Similarity
    """Where the target stands, seen from the source."""
    source_points: Tensor
    """(m, dim) float64, world units."""
    target_points: Tensor
    names: tuple[str, ...]
    report: Mapping[str, Any]
    """What ``FitReport.to_dict`` gave."""

    @property
    def aligned_points(self) -> Tensor:
        """(m, dim) the target's landmarks in the source's place, where the flow meets them."""
        return self.frame.inverse()(self.target_points)


@dataclass(frozen=True)
class Run:
    """A finished fit of two splats or more."""

    inputs: tuple[Source, ...]
    legs: tuple[Leg, ...]
    options: Mapping[str, Any]
    """What the fit was asked for, seed included."""
    folder: Path | None = None

    @property
    def is_mean(self) -> bool:
        """Whether each leg goes from one input to the mean shape, rather than to the next."""
        return bool(self.options.get("mean"))

    def load_inputs(self) -> tuple[Input, ...]:
        """The splats of the run, as they were when it was fitted.

        Raises:
            RunError: an input has moved or changed.
        """
        return tuple(_load_again(source) for source in self.inputs)

    def morph(self, inputs: Sequence[Input] | None = None, **options: Any) -> Morph | Chain:
        """What lies between the splats: a chain where they are more than two.

        Args:
            inputs: what ``load_inputs`` gave; loaded if not given.
            options: those of ``Morph``.

        Raises:
            RunError: an input has moved or changed.
            OptionError: the run is an average, which has no t, or an option that ``Morph``
                refuses.
        """
        if self.is_mean:
            raise OptionError("the run is an average of its splats (`mean`), which has no t")
        splats = [one.gaussians for one in inputs or self.load_inputs()]
        morphs = [
            Morph(source, target, leg.flow, frame=leg.frame, landmarks=leg.source_points, **options)
            for source, target, leg in zip(splats, splats[1:], self.legs, strict=False)
        ]
        return morphs[0] if len(morphs) == 1 else Chain(morphs)

    def average(self, inputs: Sequence[Input] | None = None, **options: Any) -> Gaussians:
        """The average splat of a run that was fitted to the mean shape.

        Args:
            inputs: what ``load_inputs`` gave; loaded if not given.
            options: those of ``average``.

        Raises:
            RunError: an input has moved or changed.
            OptionError: an option of morphs only, or one that ``average`` refuses.
        """
        if timed := sorted(options.keys() - {"ramp", "covariance", "blend", "on_step"}):
            raise OptionError(f"the run is an average, which has no t: leave out `{timed[0]}`")
        splats = [one.gaussians for one in inputs or self.load_inputs()]
        flows, frames = [leg.flow for leg in self.legs], [leg.frame for leg in self.legs]
        landmarks = self.legs[0].source_points
        return average(splats, flows, frames=frames, landmarks=landmarks, **options)


def remember(loaded: Input) -> Source:
    """What a run keeps of an input."""
    return Source(loaded.name, loaded.path.resolve(), loaded.sha256, dict(loaded.options))


def save_run(folder: str | Path, run: Run, reports: Sequence[FitReport]) -> Path:
    """Write the run directory; ``morph.json`` comes last and makes it a run.

    Raises:
        WriteError: something can't be written.
    """
    folder = make_folder(folder)
    tensors = {
        f"{i}.{name}": tensor.contiguous()
        for i, leg in enumerate(run.legs)
        for name, tensor in leg.flow.state_dict().items()
    }
    with atomic_write(folder / WEIGHTS) as partial:
        partial.write_bytes(save(tensors))
    with atomic_write(folder / HISTORY) as partial, partial.open("w", newline="") as stream:
        writer = csv.writer(stream)
        rows = [(i, entry) for i, report in enumerate(reports) for entry in report.history]
        if rows:
            writer.writerow(["leg", *(f.name for f in dataclasses.fields(rows[0][1]))])
        for i, entry in rows:
            writer.writerow([i, *dataclasses.astuple(entry)])
    write_json(folder / REPORT, {"legs": [dict(leg.report) for leg in run.legs]})
    manifest = {
        "format": FORMAT,
        "inputs": [
            {
                "name": source.name,
                "path": os.path.relpath(source.path, folder.resolve()),
                "sha256": source.sha256,
                "options": dict(source.options),
            }
            for source in run.inputs
        ],
        "legs": [
            {
                "flow": leg.flow.config(),
                "frame": leg.frame.to_dict(),
                "names": list(leg.names),
                "source_points": leg.source_points.tolist(),
                "target_points": leg.target_points.tolist(),
            }
            for leg in run.legs
        ],
        "weights_sha256": fingerprint((folder / WEIGHTS,)),
        "options": dict(run.options),
        "versions": {
            "splatmorph": __version__,
            "torch": torch.__version__,
            "python": platform.python_version(),
        },
    }
    write_json(folder / MANIFEST, manifest)
    if not any(report.interrupted for report in reports):
        drop_states(folder)
    return folder


def open_run(folder: str | Path) -> Run:
    """Read a run directory, without its splats.

    Raises:
        RunError: it is no run, incomplete, corrupt, or of another version of the format.
    """
    folder = Path(folder)
    if folder.is_file():
        raise RunError(
            f"{folder} is a file, expected the run directory of a fit: fit two splats first; one "
            "splat alone can be rendered, viewed and inspected"
        )
    manifest = _read_json(folder, MANIFEST)
    if manifest.get("format") != FORMAT:
        raise RunError(
            f"{folder} has run format {manifest.get('format')!r}, this version reads {FORMAT}: "
            "fit it again"
        )
    report = _read_json(folder, REPORT)
    weights = folder / WEIGHTS
    with reading(weights, "file of weights", error=RunError, remedy="fit it again"):
        if fingerprint((weights,)) != manifest.get("weights_sha256"):
            raise RunError(
                f"{weights} is not what {MANIFEST} was written with (an interrupted overwrite, "
                "or a foreign file): fit it again"
            )
        tensors = load_file(weights)
    with reading(folder, "run directory", error=RunError, remedy="fit it again"):
        legs = tuple(
            _leg(i, stored, tensors, leg_report)
            for i, (stored, leg_report) in enumerate(
                zip(manifest["legs"], report["legs"], strict=True)
            )
        )
        inputs = tuple(_source(folder, one) for one in manifest["inputs"])
        run = Run(inputs, legs, dict(manifest["options"]), folder)
        if len(inputs) < 2 or len(legs) != len(inputs) - (not run.is_mean):
            raise ValueError(f"{len(legs)} flows for {len(inputs)} inputs")
        return run


def load_run(folder: str | Path, **options: Any) -> Morph | Chain:
    """The morph of a run directory; ``options`` are those of ``Morph`` (ramp, covariance, …).

    Raises:
        RunError: the directory is no run, or its inputs have moved or changed.
        OptionError: an option that ``Morph`` refuses.
    """
    return open_run(folder).morph(**options)


def _leg(i: int, stored: Any, tensors: Mapping[str, Tensor], report: Any) -> Leg:
    prefix = f"{i}."
    own = {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
    _check_sizes(stored["flow"], own)
    _check_report(report)
    names = tuple(str(name) for name in stored["names"])
    try:
        flow = flow_from_config(stored["flow"])
        flow.load_state_dict(own)
        frame = Similarity.from_dict(stored["frame"])
        points = [
            Landmarks(torch.tensor(stored[f"{side}_points"], dtype=torch.float64), names)
            for side in SIDES
        ]
    except SplatmorphError as error:
        # It names no file.
        raise ValueError(error) from error
    if frame.dim != flow.dim or any(side.dim != flow.dim for side in points):
        raise ValueError(f"landmarks of {points[0].dim} dimensions and a flow of {flow.dim}")
    if not torch.isfinite(flow(points[0].points[:PROBES], 1.0)).all():
        raise ValueError("a flow that carries its own landmarks to infinity")
    return Leg(flow, frame, points[0].points, points[1].points, names, report)


def _check_sizes(config: Mapping[str, Any], weights: Mapping[str, Tensor]) -> None:
    """Refuse a flow that says it is larger than its weights, before it is made."""
    held = sum(tensor.numel() for tensor in weights.values())
    numbers = [value for value in config.values() if isinstance(value, int)]
    if not all(0 <= number <= max(held, MOST_STEPS) for number in numbers):
        raise ValueError("a flow larger than its weights")
    if not all(torch.isfinite(tensor).all() for tensor in weights.values()):
        raise ValueError("weights that aren't finite")


def _check_report(report: Mapping[str, Any]) -> None:
    """Refuse a report without what others look for in it."""
    numbers = [report[name] for name in ("landmarks", "mse_world", "det_min", "seconds")]
    errors = report["errors"]
    if not errors or not all(isinstance(x, int | float) for x in (*numbers, *errors.values())):
        raise TypeError("a report of no numbers")
    bool(report["interrupted"])


def _source(folder: Path, stored: Mapping[str, Any]) -> Source:
    options = dict(stored["options"])
    kinds = {"frame": int, "pose": str, "landmarks_set": str, "flame": str, "mesh": str}
    if not all(isinstance(value, kinds.get(name, ())) for name, value in options.items()):
        raise TypeError(f"unknown options of an input ({', '.join(options)})")
    path = (folder.resolve() / stored["path"]).resolve()
    return Source(str(stored["name"]), path, str(stored["sha256"]), options)


def _load_again(source: Source) -> Input:
    with reading(source.path, "input of the run", error=RunError):
        present = source.path.exists()
    if not present:
        raise RunError(
            f"the run's input {source.path} is not there any more: put it back, or fit again"
        )
    loaded = load_splat(source.path, **source.options)
    if loaded.sha256 != source.sha256:
        raise RunError(
            f"the run's input {source.path} has changed since the fit: put the old file back, or "
            "fit again"
        )
    return loaded


def _read_json(folder: Path, name: str) -> dict[str, Any]:
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise RunError(f"{folder} {what}, expected the run directory that a fit wrote")
    path = folder / name
    if not path.is_file():
        unfinished = has_state(folder)
        hint = "fit again with `resume` to finish it" if unfinished else "fit again"
        raise RunError(f"{folder} is no complete run (no {name}): {hint}")
    try:
        value = read_json(path)
    except ReadError as error:
        raise RunError(f"{error}: fit again") from error
    if not isinstance(value, dict):
        raise RunError(f"{path} holds no JSON object: fit again")
    return value
