"""``splatmorph eval``: Measure a run: landmark errors, flow laws, folding, energies."""

from __future__ import annotations

from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from cyclopts import Parameter
from torch import Tensor

from splatmorph.app import console
from splatmorph.app.options import Json, RunPath
from splatmorph.errors import ReadError
from splatmorph.io.arrays import read_npz
from splatmorph.io.reading import read_text, reading
from splatmorph.metrics import evaluate
from splatmorph.registration import half_time_gap
from splatmorph.runs.run import Leg, open_run

WORST_SHOWN = 5
SIDES = ("source", "target")


def eval(
    run: RunPath,
    /,
    *,
    held_out: Annotated[
        Path | None,
        Parameter(
            help="True correspondences to score on: .npz with arrays source and target (m, 3), "
            "or .csv of six columns x, y, z, x, y, z."
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Measure a run: landmark errors, flow laws, folding, energies."""
    opened = open_run(run)
    inputs = opened.load_inputs()
    splats = [one.gaussians.means for one in inputs]
    pairs = None if held_out is None else read_pairs(held_out)
    # A leg of an average goes from one splat to the mean shape, where no splat is.
    ends = (
        splats
        if opened.is_mean
        else [
            torch.cat([source, leg.frame.inverse()(target)])
            for leg, (source, target) in zip(opened.legs, pairwise(splats), strict=True)
        ]
    )
    legs = [measure(leg, points, pairs) for leg, points in zip(opened.legs, ends, strict=True)]
    if not opened.is_mean:
        for measured, made, pair in zip(legs, opened.legs, pairwise(inputs), strict=True):
            gap = half_time_gap(made.flow, made.frame, *(one.gaussians for one in pair))
            measured["surfaces"] = None if gap is None else asdict(gap)
    if json:
        console.emit_json({"run": str(run), "legs": legs})
    else:
        for leg in legs:
            _print(leg)


def measure(leg: Leg, splats: Tensor, pairs: tuple[Tensor, Tensor] | None) -> dict[str, Any]:
    """What ``eval`` says of one flow, in JSON's types; ``splats`` are its centers, both sides."""
    quality = evaluate(leg.flow, leg.source_points, leg.aligned_points, leg.names, splats)
    measured = {
        "flow": leg.flow.config(),
        "landmarks": len(leg.names),
        "splats": len(splats),
        **asdict(quality),
    }
    measured["det_min_at"] = list(quality.det_min_at)
    if pairs is not None:
        source, target = pairs
        before = (leg.frame(source) - target).norm(dim=1)
        after = (leg.frame(leg.flow(source, 1.0)) - target).norm(dim=1)
        measured["held_out"] = {
            "points": len(source),
            "mean_before": float(before.mean()),
            "mean": float(after.mean()),
            "median": float(after.median()),
            "max": float(after.max()),
        }
    return measured


def read_pairs(path: Path) -> tuple[Tensor, Tensor]:
    """True correspondences, two (m, 3) float64 tensors in world units.

    Raises ``ReadError`` where the file is missing or holds something else.
    """
    expected = "expected .npz with arrays source and target, or .csv of six columns"
    with reading(path, "file of correspondences", remedy=expected):
        if path.suffix.lower() == ".npz":
            stored = read_npz(path, SIDES)
            sides = [np.asarray(stored[side], dtype=np.float64) for side in SIDES]
        else:
            lines = read_text(path).splitlines()
            table = np.loadtxt(lines, delimiter=",", ndmin=2, comments="#")
            sides = [table[:, :3], table[:, 3:]]
    shapes = [side.shape for side in sides]
    if shapes[0] != shapes[1] or sides[0].ndim != 2 or sides[0].shape[1] != 3 or not sides[0].size:
        raise ReadError(f"{path} holds {shapes[0]} and {shapes[1]}, expected (m, 3) twice")
    if not all(np.isfinite(side).all() for side in sides):
        raise ReadError(f"{path} holds NaN or infinite coordinates: delete those rows")
    return torch.from_numpy(sides[0]), torch.from_numpy(sides[1])


def _print(measured: dict[str, Any]) -> None:
    laws, options = measured["laws"], measured["flow"]
    name = " ".join(str(options[key]) for key in ("kind", "field") if key in options)
    console.say(f"{name}: {measured['landmarks']} landmarks, {measured['splats']:,} splats")
    made = console.table("", "before", "after")
    made.add_row(
        "landmark MSE, world units²",
        f"{measured['mse_world_before']:.2e}",
        f"{measured['mse_world']:.2e}",
    )
    made.add_row(
        "  in units of the box²", f"{measured['mse_before']:.2e}", f"{measured['mse']:.2e}"
    )
    if held := measured.get("held_out"):
        made.add_row(
            f"held out, mean of {held['points']:,}, world units",
            f"{held['mean_before']:.4g}",
            f"{held['mean']:.4g}",
        )
    if gap := measured.get("surfaces"):
        made.add_row("surfaces at half-time, mean distance, world units", "", f"{gap['mean']:.3g}")
        made.add_row("  share without a counterpart", "", f"{gap['alone']:.1%}")
    for landmark, error in list(measured["errors"].items())[:WORST_SHOWN]:
        made.add_row(f"landmark {landmark}, at its worst t", "", f"{error:.3g}")
    for law in ("identity", "inverse", "group"):
        made.add_row(f"{law} error, of the box", "", f"{laws[law]:.1e}")
    where = ", ".join(f"{value:.4g}" for value in measured["det_min_at"])
    made.add_row(f"least determinant, at ({where})", "", f"{measured['det_min']:.3f}")
    made.add_row("largest determinant", "", f"{measured['det_max']:.3f}")
    made.add_row("first-order energy", "", f"{measured['energy_first']:.4f}")
    made.add_row("second-order energy", "", f"{measured['energy_second']:.3f}")
    console.say(made)
