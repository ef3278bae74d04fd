"""``splatmorph fit``: Fit the flow that carries one splat's landmarks to the other's: a run."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.landmarks import how_to_mend
from splatmorph.app.options import (
    DEFAULT_SEARCH,
    Auto,
    Device,
    Out,
    Overwrite,
    Searching,
    Splat,
    choose_device,
)
from splatmorph.runs.settings import DEFAULT_FITTING, DEFAULT_POSING, Finding, Fitting, Posing

if TYPE_CHECKING:
    from torch import Tensor

    from splatmorph.runs import Input, Request, Run
    from splatmorph.runs.run import Leg

FittingOptions = Annotated[Fitting, Parameter(name="*")]
PosingOptions = Annotated[Posing, Parameter(name="*")]


def fit(
    source: Splat,
    target: Splat,
    /,
    *more: Annotated[Path, Parameter(help="Further splats: a chain A → B → C …")],
    out: Out = None,
    mean: Annotated[
        bool, Parameter(negative="", help="Fit each splat to the mean shape of all instead.")
    ] = False,
    fitting: FittingOptions = DEFAULT_FITTING,
    posing: PosingOptions = DEFAULT_POSING,
    auto: Auto = True,
    refine: Annotated[
        bool,
        Parameter(
            negative="",
            help="Add landmarks on the surfaces to those given: for few (6 to 12) of them.",
        ),
    ] = False,
    searching: Searching = DEFAULT_SEARCH,
    device: Device = "cpu",
    resume: Annotated[
        bool, Parameter(negative="", help="Go on with a fit that was interrupted.")
    ] = False,
    overwrite: Overwrite = False,
) -> int:
    """Fit the flow that carries one splat's landmarks to the other's, and write a run directory.

    Where there are no landmarks, they are looked for: faces, and surfaces for the rest.

    Without -o the run is made in the current folder, as SOURCE-TARGET.run.

    With more than two splats the run is a chain whose t goes from 0 at the first to n - 1 at the
    n-th; with --mean it is their average.

    Exits with 3 where many landmarks are missed by far; the run is kept.
    """
    from splatmorph.runs.request import Request, claim_run, flow_of, folder_of
    from splatmorph.runs.state import has_state

    flow_of(fitting)
    folder = out or folder_of((source, target, *more), mean)
    claim_run(folder, resume=resume, overwrite=overwrite)
    finding = Finding(auto, refine, **vars(searching), seed=fitting.seed)
    with console.progress("looking for landmarks") as update:
        asked = Request.of(
            (source, target, *more),
            fitting,
            posing,
            finding,
            mean=mean,
            on_warning=console.warn,
            on_search=update,
        )
    warnings: list[str] = []
    try:
        with console.fitting() as on_step:
            run = asked.fit(
                folder,
                device=choose_device(device),
                resume=resume,
                overwrite=overwrite,
                on_step=on_step,
                on_warning=warnings.append,
            )
    except KeyboardInterrupt:
        if has_state(folder):
            console.warn("interrupted: the same command with --resume goes on")
        raise
    missed = [leg.report["status"] for leg in run.legs if leg.report["missed"]]
    for status in missed:
        console.fail(status)
    for warning in warnings:
        console.warn(warning)
    _summarise(asked, run, folder)
    if any(leg.report["interrupted"] for leg in run.legs):
        return console.INTERRUPTED
    return console.MISSED if missed else 0


def _summarise(asked: Request, run: Run, folder: Path) -> None:
    """The page that a fit ends with: what was met, what the flow keeps, what to type next."""
    from splatmorph.runs.standing import standing
    from splatmorph.runs.state import has_state

    names = " → ".join(one.name for one in asked.inputs)
    counts = " + ".join(f"{len(one.gaussians):,}" for one in asked.inputs)
    console.say(f"{names}: {counts} splats")
    for one, pair in zip(asked.legs, pairwise(asked.inputs), strict=False):
        if one.found is not None:
            console.say(str(one.found))
            if one.found.doubtful:
                console.say(how_to_mend(pair[0].path, pair[1].path, start="auto"))
    for i, leg in enumerate(run.legs):
        report = leg.report
        if said := standing(leg.frame, leg.source_points, _offset(asked, i)):
            console.say(said)
        if report["interrupted"]:
            way = "--resume goes on" if has_state(folder) else "-w begins anew"
            console.warn(f"interrupted: the best flow so far is kept; the same command with {way}")
        console.say(
            f"{report['landmarks']} landmarks, {report['seconds']:.2f} s: {report['status']}"
        )
        if report["predicted"] is not None:
            console.say(f"landmarks predict one another within {report['predicted']:.2g}")
        console.say(_errors_of(report))
        if not (asked.mean or console.manner.quiet):
            console.say(_gap_of(leg, asked.inputs[i : i + 2]))
        shown = ", ".join(f"{name} {value:.1e}" for name, value in report["laws"].items())
        console.say(f"flow laws, largest error in units of the box: {shown}")
        console.say(
            f"volume: det ∂Φ/∂x from {report['det_min']:.3g} to {report['det_max']:.3g}, "
            "over a sample of the splats"
        )
    console.say("")
    console.say(f"wrote {folder}")
    console.say("next:")
    typed = shlex.quote(str(folder))
    console.say(f"  splatmorph render {typed}              a turntable while it morphs")
    console.say(f"  splatmorph export {typed} --frames 5   the splats in between")
    page = shlex.quote(f"{folder.name.removesuffix('.run')}.html")
    console.say(f"  splatmorph view {typed} -o {page}   a page to open in any browser, offline")


def _gap_of(leg: Leg, pair: Sequence[Input]) -> str:
    """Whether the surfaces meet, landmarks met or not."""
    from splatmorph.registration import half_time_gap

    gap = half_time_gap(leg.flow, leg.frame, *(one.gaussians for one in pair))
    if gap is None:
        return "surfaces at half-time: nothing solid to compare"
    return (
        f"surfaces at half-time: {gap.mean:.3g} world units apart on average, "
        f"{gap.alone:.0%} without a counterpart"
    )


def _offset(asked: Request, leg: int) -> Tensor | None:
    """How far the target's offset is from the source's; None for a leg to the mean shape."""
    import torch

    if asked.mean:
        return None
    source, target = (torch.tensor(one.gaussians.offset) for one in asked.inputs[leg : leg + 2])
    return target.double() - source.double()


def _errors_of(report: Mapping[str, Any]) -> Any:
    made = console.table("landmark error", "before", "after")
    rms_before, rms = (3 * report["mse_world_before"]) ** 0.5, (3 * report["mse_world"]) ** 0.5
    made.add_row("root mean square distance, world units", f"{rms_before:.3g}", f"{rms:.3g}")
    made.add_row("  in mm, if the unit is the metre", f"{1e3 * rms_before:.3g}", f"{1e3 * rms:.3g}")
    made.add_row(
        "MSE a coordinate (the paper's metric), world units²",
        f"{report['mse_world_before']:.2e}",
        f"{report['mse_world']:.2e}",
    )
    made.add_row("  in units of the box²", f"{report['mse_before']:.2e}", f"{report['mse']:.2e}")
    worst, error = next(iter(report["errors"].items()))
    made.add_row(f"worst landmark, at its worst t: {worst}", "", f"{error:.3g}")
    return made
