"""``splatmorph fit``: two splats in, a run directory out."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import torch
from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.options import Device, Out, Overwrite, Seed, Splat, choose_device
from splatmorph.app.posing import Pair, Posing, landmarks_of
from splatmorph.errors import OutputExistsError
from splatmorph.fitting import FitConfig, FitProgress, FitReport
from splatmorph.fitting import fit as fit_flow
from splatmorph.flows import Flow, Node, make_flow
from splatmorph.landmarks import Landmarks
from splatmorph.morph.chain import mean_landmarks
from splatmorph.runs.inputs import Input as Loaded
from splatmorph.runs.run import (
    MANIFEST,
    Leg,
    Run,
    has_state,
    load_state,
    remember,
    save_run,
    save_state,
)

Matched = tuple[torch.Tensor, torch.Tensor, tuple[str, ...]]

MOST_DOMAIN_POINTS = 20_000


@Parameter(name="*")
@dataclass(frozen=True)
class Fitting:
    """Which flow, and how it is fitted."""

    flow: str = Node.kind
    """node or ncf; or a baseline: ifmorph, tps, linear."""
    field: Annotated[str | None, Parameter(show_default=False)] = None
    """Of the node flow: spline (the default) or siren."""
    smoothing: float = FitConfig.smoothing
    """Weight of bending against missed landmarks; raise it for noisy ones, 0 meets them."""
    energy: str | None = None
    """What training keeps small: jacobian (the paper's) or hessian."""
    steps: int | None = None
    """Most training steps."""
    seed: Seed = 0

    def make(self) -> Flow:
        """The unfitted flow in space."""
        options = {"field": self.field} if self.field else {}
        return make_flow(self.flow, dim=3, **options)

    def config(self) -> FitConfig:
        """What the library's ``fit`` is told."""
        return FitConfig(
            seed=self.seed, steps=self.steps, smoothing=self.smoothing, energy=self.energy
        )


CANONICAL_POSE = Posing()
BY_DEFAULT = Fitting()


def fit(
    source: Splat,
    target: Splat,
    /,
    *more: Annotated[Path, Parameter(help="Further splats: a chain A → B → C …")],
    out: Out = None,
    mean: Annotated[
        bool, Parameter(negative="", help="Fit each splat to the mean shape of all instead.")
    ] = False,
    fitting: Fitting = BY_DEFAULT,
    posing: Posing = CANONICAL_POSE,
    device: Device = "cpu",
    resume: Annotated[
        bool, Parameter(negative="", help="Go on with a fit that was interrupted.")
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Fit the flow that carries one splat's landmarks to the other's, and write a run directory.

    Without -o the run is made in the current folder, as SOURCE-TARGET.run.

    With more than two splats the run is a chain whose t goes from 0 at the first to n - 1 at the
    n-th; with --mean it is their average.
    """
    asked = Request.of((source, target, *more), posing, fitting, mean=mean)
    names = "-".join(one.name for one in asked.loaded)
    folder = out or Path(names + ("-mean.run" if mean else ".run"))
    claim_run(folder, resume, overwrite)
    _summarise(folder, asked.loaded, asked.fit(folder, device, resume))


@dataclass(frozen=True)
class Request:
    """A fit as it is asked for, everything loaded."""

    loaded: tuple[Loaded, ...]
    ends: tuple[Pair, ...]
    """The landmarks that each flow goes between."""
    matched: tuple[Matched, ...]
    """The same point by point: sources, targets, names."""
    fitting: Fitting
    options: Mapping[str, Any]
    """What the run is told to remember of it."""

    @staticmethod
    def of(
        paths: Sequence[Path], posing: Posing, fitting: Fitting, *, mean: bool = False
    ) -> Request:
        """Load the splats and match their landmarks.

        Raises:
            SplatmorphError: an input can't be read, or has no landmarks that match.
        """
        loaded = posing.load(paths)
        ends = [posing.thinned(leg) for leg in _legs([landmarks_of(one) for one in loaded], mean)]
        return Request(
            tuple(loaded),
            tuple(ends),
            tuple(p.match(q) for p, q in ends),
            fitting,
            dataclasses.asdict(fitting) | {"mean": mean},
        )

    def made(self, run: Run) -> bool:
        """Whether ``run`` is a fit of the same inputs and landmarks with the same options."""
        kept = [(leg.source_points, leg.target_points, leg.names) for leg in run.legs]
        return (
            run.options == self.options
            and run.inputs == tuple(remember(one) for one in self.loaded)
            and len(kept) == len(self.matched)
            and all(
                torch.equal(p, a) and torch.equal(q, b) and tuple(names) == stored
                for (p, q, names), (a, b, stored) in zip(self.matched, kept, strict=True)
            )
        )

    def fit(self, folder: Path, device: str, resume: bool) -> list[FitReport]:
        """Fit each flow and write the run.

        Raises:
            KeyboardInterrupt: with flows left to fit; what was done is kept.
            SplatmorphError: a fit fails, or the run can't be written.
        """
        mean = self.options["mean"]
        told = [self.options, [[names, p.tolist(), q.tolist()] for p, q, names in self.matched]]
        made, reports = [], []
        for i, ends in enumerate(self.ends):
            flow = self.fitting.make().to(choose_device(device))
            domain = _domain([self.loaded[i]] if mean else self.loaded[i : i + 2])
            asked = json.dumps([i, *told])
            reports.append(_fit_leg(flow, ends, domain, self.fitting, folder, i, asked, resume))
            made.append(Leg(flow.cpu(), *self.matched[i], reports[-1].to_dict()))
            if reports[-1].interrupted and i + 1 < len(self.ends):
                console.warn("interrupted: the same command with --resume goes on")
                raise KeyboardInterrupt
        inputs = tuple(remember(one) for one in self.loaded)
        save_run(folder, Run(inputs, tuple(made), self.options), reports)
        return reports


def _legs(points: Sequence[Landmarks], mean: bool) -> list[Pair]:
    if not mean:
        return list(itertools.pairwise(points))
    middle = mean_landmarks(points)
    return [(one, middle) for one in points]


def claim_run(folder: Path, resume: bool, overwrite: bool) -> None:
    """Refuse a folder that a run may not be written to.

    Raises:
        OutputExistsError: something is there that may not be replaced or gone on with.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputExistsError(f"{folder} is a file: give -o to write the run elsewhere")
    finished = (folder / MANIFEST).is_file()
    if resume:
        if finished and not has_state(folder):
            raise OutputExistsError(f"{folder} is finished, nothing is left to --resume")
        return
    if finished and not overwrite:
        raise OutputExistsError(
            f"{folder} is a finished run: give -w to fit it anew, or -o to write elsewhere"
        )
    if folder.is_dir() and not overwrite and any(folder.iterdir()):
        raise OutputExistsError(
            f"{folder} is there already and no finished run: give --resume to go on with an "
            "interrupted fit, -w to fit anew, or -o to write elsewhere"
        )


def _domain(loaded: Sequence[Loaded]) -> torch.Tensor:
    each = MOST_DOMAIN_POINTS // len(loaded)
    means = [one.gaussians.means for one in loaded]
    return torch.cat([m[:: max(1, len(m) // each)] for m in means]).double()


def _fit_leg(
    flow: Flow,
    points: tuple[Landmarks, Landmarks],
    domain: torch.Tensor,
    fitting: Fitting,
    folder: Path,
    number: int,
    asked: str,
    resume: bool,
) -> FitReport:
    state = load_state(folder, number, asked) if resume else None
    with console.progress("fitting") as update:

        def on_step(step: FitProgress) -> None:
            update(step.step, step.steps, f"landmark MSE {step.mse:.1e}")

        return fit_flow(
            flow,
            *points,
            fitting.config(),
            domain=domain.to(flow.center.device),
            on_step=on_step,
            resume=state,
            on_state=lambda kept: save_state(folder, number, kept, asked),
        )


def _summarise(folder: Path, loaded: Sequence[Loaded], reports: Sequence[FitReport]) -> None:
    """The page that a fit ends with: what was met, what the flow keeps, what to type next."""
    names = " → ".join(one.name for one in loaded)
    console.say(f"{names}: {' + '.join(f'{len(one.gaussians):,}' for one in loaded)} splats")
    for report in reports:
        if report.interrupted:
            way = "--resume goes on" if has_state(folder) else "-w begins anew"
            console.warn(f"interrupted: the best flow so far is kept; the same command with {way}")
        for warning in report.warnings:
            console.warn(warning)
        console.say(f"{report.landmarks} landmarks, {report.seconds:.2f} s: {report.status}")
        console.say(_errors_of(report))
        laws = dataclasses.asdict(report.laws)
        shown = ", ".join(f"{name} {value:.1e}" for name, value in laws.items())
        console.say(f"flow laws, largest error in units of the box: {shown}")
        console.say(f"volume: det ∂Φ/∂x from {report.det_min:.3g} to {report.det_max:.3g}")
    console.say(f"\nwrote {folder}\nnext:")
    console.say(f"  splatmorph render {folder}              a turntable while it morphs")
    console.say(f"  splatmorph export {folder} --frames 5   the splats in between")


def _errors_of(report: FitReport) -> Any:
    made = console.table("landmark error", "before", "after")
    rms_before, rms = (3 * report.mse_world_before) ** 0.5, (3 * report.mse_world) ** 0.5
    made.add_row("root mean square distance, world units", f"{rms_before:.3g}", f"{rms:.3g}")
    made.add_row("  in mm, if the unit is the metre", f"{1e3 * rms_before:.3g}", f"{1e3 * rms:.3g}")
    made.add_row(
        "MSE a coordinate (the paper's metric), world units²",
        f"{report.mse_world_before:.2e}",
        f"{report.mse_world:.2e}",
    )
    made.add_row("  in units of the box²", f"{report.mse_before:.2e}", f"{report.mse:.2e}")
    worst, error = next(iter(report.errors.items()))
    made.add_row(f"worst landmark, at its worst t: {worst}", "", f"{error:.3g}")
    return made
