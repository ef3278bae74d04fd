"""Request: a fit that is asked for, everything loaded, and the run that it makes."""

from __future__ import annotations

import dataclasses
import itertools
import json
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from splatmorph.errors import OptionError, OutputExistsError, WriteError
from splatmorph.fitting import FitConfig, FitProgress, FitReport, fit
from splatmorph.flows import Flow, make_flow
from splatmorph.geometry.alignment import similarity_between
from splatmorph.geometry.similarity import Similarity
from splatmorph.landmarks import Landmarks
from splatmorph.morph import mean_landmarks
from splatmorph.registration import Found
from splatmorph.registration.search import OnStep as OnSearch
from splatmorph.runs.finding import described, find, find_common
from splatmorph.runs.inputs import Input, as_in_file, name_of
from splatmorph.runs.posing import Pair, landmarks_of, load_inputs, thinned
from splatmorph.runs.run import MANIFEST, Leg, Run, remember, save_run
from splatmorph.runs.settings import (
    DEFAULT_FINDING,
    DEFAULT_FITTING,
    DEFAULT_POSING,
    Finding,
    Fitting,
    Posing,
)
from splatmorph.runs.state import has_state, load_state, save_state

MOST_DOMAIN_POINTS = 20_000
"""Centers of splats that stand for the objects that a flow moves."""

OnStep = Callable[[FitProgress], None]
OnWarning = Callable[[str], None]


@dataclass(frozen=True)
class LegRequest:
    """One flow that is asked for: from where to where, and what it moves."""

    source_points: Tensor
    """(m, 3) float64, world units."""
    target_points: Tensor
    """(m, 3) float64: where they go."""
    names: tuple[str, ...]
    given: Tensor
    """(m,) which of them somebody vouches for; the others were found."""
    frame: Similarity
    """Where the target stands, seen from the source: what the flow need not do."""
    domain: Tensor
    """(n, 3) float64, world units: where the objects are, the target in the source's place."""
    found: Found | None = None
    """What a search found, where landmarks were looked for."""

    @staticmethod
    def of(pair: Pair, moved: Sequence[Input], found: Found | None = None) -> LegRequest:
        """Match the landmarks of a leg that moves the splats of ``moved``.

        Raises:
            LandmarkError: they don't match, or mirror each other.
        """
        p, q, names = pair[0].match(pair[1])
        frame = similarity_between(p, q)
        each = MOST_DOMAIN_POINTS // len(moved)
        means = [one.gaussians.means[:: max(1, len(one.gaussians) // each)] for one in moved]
        places = Similarity.identity(), frame.inverse()
        domain = [place(m.double()) for place, m in zip(places, means, strict=False)]
        given = pair[0].given(names) & pair[1].given(names)
        return LegRequest(p, q, names, given, frame, torch.cat(domain), found)

    def made(self, leg: Leg) -> bool:
        """Whether ``leg`` goes between the same landmarks."""
        return (
            leg.names == self.names
            and torch.equal(leg.source_points, self.source_points)
            and torch.equal(leg.target_points, self.target_points)
        )


@dataclass(frozen=True)
class Request:
    """A fit as it is asked for, everything loaded."""

    inputs: tuple[Input, ...]
    legs: tuple[LegRequest, ...]
    fitting: Fitting
    mean: bool
    """Whether each leg goes from one input to the mean shape, rather than to the next."""
    finding: Finding | None = None
    """How landmarks were looked for, where they were."""

    @staticmethod
    def of(
        paths: Sequence[str | Path],
        fitting: Fitting = DEFAULT_FITTING,
        posing: Posing = DEFAULT_POSING,
        finding: Finding = DEFAULT_FINDING,
        *,
        mean: bool = False,
        on_warning: OnWarning | None = None,
        on_search: OnSearch | None = None,
    ) -> Request:
        """Load the splats, match or find their landmarks; see :func:`fit_run` for the arguments.

        Raises:
            SplatmorphError: an input can't be read, or has no landmarks that match.
        """
        if len(paths) < 2:
            raise OptionError(f"{len(paths)} splats are given, expected two or more")
        warn = on_warning or _log_warning
        inputs = load_inputs(paths, posing, warn)
        if mean:
            common = find_common(finding, inputs, on_search, warn)
            legs = _legs_to_mean(inputs, common or [landmarks_of(one) for one in inputs], posing)
            return Request(inputs, legs, fitting, mean, finding if common else None)
        chain = []
        for pair in itertools.pairwise(inputs):
            found = find(finding, *pair, on_search, warn)
            if found is None:
                points = thinned((landmarks_of(pair[0]), landmarks_of(pair[1])), posing)
            else:
                points = found.source, found.target
            chain.append(LegRequest.of(points, pair, found))
        searched = any(leg.found is not None for leg in chain)
        return Request(inputs, tuple(chain), fitting, mean, finding if searched else None)

    @property
    def folder(self) -> Path:
        """Where the run is written if nobody says; see :func:`folder_of`."""
        return folder_of([one.path for one in self.inputs], self.mean)

    @property
    def options(self) -> Mapping[str, Any]:
        """What the run remembers of how it was asked for."""
        return _options(self.inputs, self.fitting, self.mean, self.finding)

    def made(self, run: Run) -> bool:
        """Whether ``run`` is a fit of the same inputs and landmarks with the same options."""
        return (
            run.options == self.options
            and run.inputs == tuple(remember(one) for one in self.inputs)
            and len(run.legs) == len(self.legs)
            and all(one.made(leg) for one, leg in zip(self.legs, run.legs, strict=True))
        )

    def fit(
        self,
        out: str | Path | None = None,
        *,
        device: str = "cpu",
        resume: bool = False,
        overwrite: bool = False,
        on_step: OnStep | None = None,
        on_warning: OnWarning | None = None,
    ) -> Run:
        """Fit each flow and write the run; see :func:`fit_run` for the arguments."""
        folder = self.folder if out is None else Path(out)
        claim_run(folder, resume=resume, overwrite=overwrite)
        made: list[Leg] = []
        reports: list[FitReport] = []
        for i, leg in enumerate(self.legs):
            flow = flow_of(self.fitting).to(device)
            report = self._fit_leg(i, flow, folder, resume, on_step)
            reports.append(report)
            for warning in report.warnings:
                (on_warning or _log_warning)(warning)
            if report.interrupted and i + 1 < len(self.legs):
                raise KeyboardInterrupt
            points = leg.source_points, leg.target_points
            made.append(Leg(flow.cpu(), leg.frame, *points, leg.names, report.to_dict()))
        inputs = tuple(remember(one) for one in self.inputs)
        run = Run(inputs, tuple(made), self.options, folder)
        save_run(folder, run, reports)
        for i, leg in enumerate(self.legs):
            if leg.found is not None:
                sides = zip(
                    self.inputs[i : i + 2], (leg.found.source, leg.found.target), strict=True
                )
                for one, landmarks in sides:
                    stem = one.name if len(self.legs) == 1 else f"{i}-{one.name}"
                    path = folder / f"{stem}.landmarks.json"
                    as_in_file(landmarks, one.gaussians).write(path)
        return run

    def _fit_leg(
        self, number: int, flow: Flow, folder: Path, resume: bool, on_step: OnStep | None
    ) -> FitReport:
        leg = self.legs[number]
        asked = self._signature(number)
        return fit(
            flow,
            Landmarks(leg.source_points, leg.names, leg.given.double()),
            Landmarks(leg.target_points, leg.names).moved(leg.frame.inverse()),
            _config_of(self.fitting),
            domain=leg.domain.to(flow.center.device),
            on_step=on_step,
            resume=load_state(folder, number, asked) if resume else None,
            on_state=lambda kept: save_state(folder, number, kept, asked),
        )

    def _signature(self, number: int) -> str:
        # Tells an unfinished leg from one of another fit.
        points = [
            [leg.names, leg.source_points.tolist(), leg.target_points.tolist()] for leg in self.legs
        ]
        return json.dumps([number, self.options, points])


def fit_run(
    *paths: str | Path,
    out: str | Path | None = None,
    fitting: Fitting = DEFAULT_FITTING,
    posing: Posing = DEFAULT_POSING,
    finding: Finding = DEFAULT_FINDING,
    mean: bool = False,
    device: str = "cpu",
    resume: bool = False,
    overwrite: bool = False,
    on_step: OnStep | None = None,
    on_warning: OnWarning | None = None,
) -> Run:
    """Fit the flows that carry splats into each other, and write the run directory.

        run = sm.fit_run("a.ply", "b.ply", fitting=sm.Fitting(flow="ncf"))
        middle = run.morph().at(0.5)

    Args:
        paths: two splats or more, as :func:`load_input` takes them; more than two make a chain.
        out: the run directory; ``A-B.run`` in the current folder if not given.
        fitting: which flow, and how it is fitted.
        posing: where landmarks come from, and how avatars are posed.
        finding: whether and how landmarks are looked for where none are given; what is found
            is written into the run, to be looked at and mended.
        mean: fit each splat to the mean shape of all, rather than to the next.
        device: of torch, where the flows are fitted.
        resume: go on with a fit that was interrupted in ``out``.
        overwrite: replace what is in ``out``.
        on_step: called with the progress of each leg in turn.
        on_warning: called with what may look wrong, a line each; without it they are logged.

    ``KeyboardInterrupt`` during the last leg keeps the best flow so far, and its report says so;
    earlier it is raised, and ``resume`` goes on.

    Raises:
        OutputExistsError: something is in ``out`` that may not be replaced or gone on with.
        SplatmorphError: an input or its landmarks can't be read, the fit fails, or the run can't
            be written.
    """
    request = Request.of(paths, fitting, posing, finding, mean=mean, on_warning=on_warning)
    return request.fit(
        out,
        device=device,
        resume=resume,
        overwrite=overwrite,
        on_step=on_step,
        on_warning=on_warning,
    )


def folder_of(paths: Sequence[str | Path], mean: bool = False) -> Path:
    """Where the run of these inputs is written: in the current folder, named by them."""
    names = "-".join(name_of(path) for path in paths)
    return Path(f"{names}-mean.run" if mean else f"{names}.run")


def claim_run(folder: Path, *, resume: bool, overwrite: bool) -> None:
    """Refuse a folder that a run may not be written to.

    Raises:
        OutputExistsError: something is there that may not be replaced or gone on with.
        WriteError: a file is where the folder would be.
    """
    if folder.exists() and not folder.is_dir():
        raise WriteError(f"{folder} is a file: give another `out` for the run")
    finished = (folder / MANIFEST).is_file()
    if resume:
        if finished and not has_state(folder):
            raise OutputExistsError(f"{folder} is finished, nothing is left to `resume`")
        return
    if finished and not overwrite:
        raise OutputExistsError(
            f"{folder} is a finished run: give `overwrite` to fit it anew, or another `out`"
        )
    if folder.is_dir() and not overwrite and any(folder.iterdir()):
        raise OutputExistsError(
            f"{folder} is there already and no finished run: give `resume` to go on with an "
            "interrupted fit, `overwrite` to fit anew, or another `out`"
        )


def made_by_search(
    run: Run,
    paths: Sequence[str | Path],
    fitting: Fitting,
    posing: Posing,
    finding: Finding,
) -> bool:
    """Whether ``run`` is a chain of these inputs, fitted so, for which landmarks were found so.

    Then the search, which always finds the same, need not be made again to say so.
    """
    if "finding" not in run.options:
        return False
    inputs = load_inputs(paths, posing, lambda _: None)
    if run.options != _options(inputs, fitting, False, finding):
        return False
    return run.inputs == tuple(remember(one) for one in inputs) and all(
        one.landmarks is None or other.landmarks is None
        for one, other in itertools.pairwise(inputs)
    )


def _options(
    inputs: Sequence[Input], fitting: Fitting, mean: bool, finding: Finding | None
) -> dict[str, Any]:
    searched = {} if finding is None else {"finding": described(finding, inputs)}
    return dataclasses.asdict(fitting) | {"mean": mean} | searched


def _legs_to_mean(
    inputs: Sequence[Input], points: Sequence[Landmarks], posing: Posing
) -> tuple[LegRequest, ...]:
    middle = mean_landmarks(points)
    return tuple(
        LegRequest.of(thinned((marks, middle), posing), [one])
        for marks, one in zip(points, inputs, strict=True)
    )


def flow_of(asked: Fitting) -> Flow:
    """The flow that is asked for, unfitted.

    Raises:
        OptionError: there is no such flow, or it has no fields.
    """
    options = {"field": asked.field} if asked.field else {}
    return make_flow(asked.flow, dim=3, **options)


def _config_of(asked: Fitting) -> FitConfig:
    return FitConfig(
        seed=asked.seed, steps=asked.steps, smoothing=asked.smoothing, energy=asked.energy
    )


def _log_warning(message: str) -> None:
    logging.getLogger("splatmorph").warning(message)
