"""How good a run is: its flows measured, over its splats and on correspondences held back."""

from __future__ import annotations

from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from splatmorph.errors import ReadError
from splatmorph.gaussians import Gaussians
from splatmorph.io.arrays import read_npz
from splatmorph.io.reading import read_text, reading
from splatmorph.metrics import evaluate
from splatmorph.registration import half_time_gap
from splatmorph.runs.run import Leg, Run

SIDES = ("source", "target")


def measure(run: Run, pairs: tuple[Tensor, Tensor] | None = None) -> list[dict[str, Any]]:
    """What is to say of each leg, in JSON's types: ``metrics.Quality`` and what follows.

    ``held_out``, where ``pairs`` (as of ``read_pairs``) are given: how far the flow's end is from
    the truth, world units. ``surfaces``, but for an average: ``half_time_gap``.

    Raises ``ReadError`` where an input isn't what it was, or isn't there.
    """
    inputs = run.load_inputs()
    splats = [one.gaussians.means for one in inputs]
    # A leg of an average goes from one splat to the mean shape, where no splat is.
    ends = (
        splats
        if run.is_mean
        else [
            torch.cat([source, leg.frame.inverse()(target)])
            for leg, (source, target) in zip(run.legs, pairwise(splats), strict=True)
        ]
    )
    # A mean shape lies where the first splat does.
    others = inputs[:1] * len(inputs) if run.is_mean else inputs[1:]
    legs = [
        _measured(leg, points, pairs and _without_offsets(pairs, one.gaussians, other.gaussians))
        for leg, points, one, other in zip(run.legs, ends, inputs, others, strict=False)
    ]
    if not run.is_mean:
        for measured, made, pair in zip(legs, run.legs, pairwise(inputs), strict=True):
            gap = half_time_gap(made.flow, made.frame, *(one.gaussians for one in pair))
            measured["surfaces"] = None if gap is None else asdict(gap)
    return legs


def _without_offsets(
    pairs: tuple[Tensor, Tensor], source: Gaussians, target: Gaussians
) -> tuple[Tensor, Tensor]:
    """Pairs in the coordinates of the files as pairs in those of the centers."""
    p, q = (
        points - points.new_tensor(one.offset)
        for points, one in zip(pairs, (source, target), strict=True)
    )
    return p, q


def _measured(leg: Leg, splats: Tensor, pairs: tuple[Tensor, Tensor] | None) -> dict[str, Any]:
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
