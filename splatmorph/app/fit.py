"""``splatmorph fit``: two splats in, a run directory out."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.options import Device, Input, Out, Overwrite, Seed, choose_device
from splatmorph.avatars import pose_warnings
from splatmorph.errors import LandmarkError, OutputExistsError
from splatmorph.fit import FitConfig, FitProgress, FitReport, FitState
from splatmorph.fit import fit as fit_flow
from splatmorph.flows import Flow, make_flow
from splatmorph.inputs import Input as Loaded
from splatmorph.inputs import load_input
from splatmorph.landmarks import Landmarks
from splatmorph.run import MANIFEST, Leg, Run, load_state, remember, save_run, save_state

MOST_DOMAIN_POINTS = 20_000


@Parameter(name="*")
@dataclass(frozen=True)
class Posing:
    """How avatars are posed; plain splats stay as they are."""

    frame: int | None = None
    """Pose avatars as in this frame of their tracks; canonical if not given."""
    pose_from: Literal["source", "target"] | None = None
    """Take the pose of both from this one's track, so that mouths agree."""
    landmarks_set: Literal["70", "254", "dense"] = "254"
    """Which landmarks of the FLAME mesh to use."""
    flame: Path | None = None
    """The FLAME model file or its folder; else the variable SPLATMORPH_FLAME."""


CANONICAL_POSE = Posing()


def fit(
    source: Input,
    target: Input,
    /,
    *,
    out: Out = None,
    source_landmarks: Annotated[
        Path | None, Parameter(help="Default: <source>.landmarks.* beside the source.")
    ] = None,
    target_landmarks: Annotated[
        Path | None, Parameter(help="Default: <target>.landmarks.* beside the target.")
    ] = None,
    flow: Annotated[
        str, Parameter(help="node or ncf; or a baseline: ifmorph, tps, linear.")
    ] = "node",
    field: Annotated[str | None, Parameter(help="Of the node flow: spline or siren.")] = None,
    smoothing: Annotated[
        float, Parameter(help="Weight of bending against missed landmarks; 0 meets them.")
    ] = FitConfig.smoothing,
    steps: Annotated[int | None, Parameter(help="Most training steps.")] = None,
    posing: Posing = CANONICAL_POSE,
    seed: Seed = 0,
    device: Device = "cpu",
    resume: Annotated[
        bool, Parameter(negative="", help="Go on with a fit that was interrupted.")
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Fit the flow that carries one splat's landmarks to the other's, and write a run directory.

    Without -o the run is made in the current folder, as SOURCE-TARGET.run.
    """
    loaded = _load_pair((source, target), (source_landmarks, target_landmarks), posing)
    folder = out or Path(f"{loaded[0].name}-{loaded[1].name}.run")
    options = {"flow": flow, "field": field, "smoothing": smoothing, "steps": steps, "seed": seed}
    points = [_landmarks_of(one) for one in loaded]
    p, q, names = points[0].match(points[1])
    asked = json.dumps([options, names, p.tolist(), q.tolist()])
    state = _claim_run(folder, asked, resume, overwrite)
    torch.manual_seed(seed)
    made = make_flow(flow, dim=3, **({"field": field} if field else {})).to(choose_device(device))
    config = FitConfig(seed=seed, steps=steps, smoothing=smoothing)
    report = _fit_one(made, points, _domain(loaded), config, folder, asked, state)
    leg = Leg(made.cpu(), p, q, names, report.to_dict())
    run = Run(tuple(remember(one) for one in loaded), (leg,), options)
    save_run(folder, run, [report])
    summarise(folder, loaded, report)


def _load_pair(
    paths: tuple[Path, Path], landmarks: tuple[Path | None, Path | None], posing: Posing
) -> list[Loaded]:
    wanted: dict[str, Any] = {
        "frame": posing.frame,
        "landmarks_set": posing.landmarks_set,
        "flame": posing.flame,
    }
    if posing.pose_from is not None:
        wanted["pose"] = paths[0] if posing.pose_from == "source" else paths[1]
    loaded = [
        load_input(path, landmarks=given, **wanted)
        for path, given in zip(paths, landmarks, strict=True)
    ]
    if any(one.avatar for one in loaded):
        for warning in pose_warnings(loaded[0].avatar, loaded[1].avatar):
            console.warn(warning)
    return loaded


def _claim_run(folder: Path, asked: str, resume: bool, overwrite: bool) -> FitState | None:
    finished = (folder / MANIFEST).is_file()
    if resume:
        state = load_state(folder, asked)
        if state is None and finished:
            raise OutputExistsError(f"{folder} is finished, nothing is left to --resume")
        return state
    if finished and not overwrite:
        raise OutputExistsError(
            f"{folder} is a finished run: give -w to fit it anew, or -o to write elsewhere"
        )
    if folder.is_dir() and not finished and not overwrite and any(folder.iterdir()):
        raise OutputExistsError(
            f"{folder} is there already and no finished run: give --resume to go on with an "
            "interrupted fit, -w to fit anew, or -o to write elsewhere"
        )
    if folder.exists() and not folder.is_dir():
        raise OutputExistsError(f"{folder} is a file: give -o to write the run elsewhere")
    return None


def _landmarks_of(loaded: Loaded) -> Landmarks:
    if loaded.landmarks is None:
        stem = loaded.path.with_suffix("")
        raise LandmarkError(
            f"{loaded.path} has no landmarks beside it: put them in {stem.name}.landmarks.json "
            '({"points": {"nose": [x, y, z], …}}), or give --source-landmarks and '
            "--target-landmarks"
        )
    return loaded.landmarks


def _domain(loaded: Sequence[Loaded]) -> torch.Tensor:
    each = MOST_DOMAIN_POINTS // len(loaded)
    means = [one.gaussians.means for one in loaded]
    return torch.cat([m[:: max(1, len(m) // each)] for m in means]).double()


def _fit_one(
    flow: Flow,
    points: Sequence[Landmarks],
    domain: torch.Tensor,
    config: FitConfig,
    folder: Path,
    asked: str,
    state: FitState | None,
) -> FitReport:
    with console.progress("fitting") as update:

        def on_step(step: FitProgress) -> None:
            update(step.step, step.steps, f"landmark MSE {step.mse:.1e}")

        return fit_flow(
            flow,
            points[0],
            points[1],
            config,
            domain=domain,
            on_step=on_step,
            resume=state,
            on_state=lambda kept: save_state(folder, kept, asked),
        )


def summarise(folder: Path, loaded: Sequence[Loaded], report: FitReport) -> None:
    """Print the page that a fit ends with: what was met, what the flow keeps, what to type next."""
    names = " → ".join(one.name for one in loaded)
    counts = " + ".join(f"{len(one.gaussians):,}" for one in loaded)
    if report.interrupted:
        console.warn("interrupted: the best flow so far is kept; the same command with --resume goes on")
    console.say(f"{names}: {counts} splats, {report.landmarks} landmarks, {report.seconds:.2f} s")
    console.say(error_table(report))
    laws: dict[str, Any] = report.to_dict()["laws"]
    shown = ", ".join(f"{name} {value:.1e}" for name, value in laws.items())
    console.say(f"flow laws, largest error in units of the box: {shown}")
    console.say(report.status)
    console.say(f"\nwrote {folder}\nnext:")
    console.say(f"  splatmorph render {folder}              a turntable while it morphs")
    console.say(f"  splatmorph export {folder} --frames 5   PLY files in between")


def error_table(report: FitReport) -> Any:
    """Landmark errors before and after, in world units and as the paper's metric."""
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
    worst = max(report.errors, key=report.errors.__getitem__)
    made.add_row(f"worst landmark at t = 1: {worst}", "", f"{report.errors[worst]:.3g}")
    return made
