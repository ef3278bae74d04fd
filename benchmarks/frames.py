"""How well landmarks are met where two captures stand apart, beside the same pair at rest.

    python benchmarks/frames.py DATA [--flows spline siren ncf tps] [--corners]

The heads james and status; the target is turned about x, y and z, scaled and moved by multiples of
its radius R. Prints Markdown: for each flow the worst miss at rest, as a part of the head, and the
largest ratio to it over all cells. ``--corners`` takes the ends of each range only, for flows that
take long to train.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import torch
from pairs import head

from splatmorph.fitting import fit
from splatmorph.flows import make_flow
from splatmorph.geometry.alignment import similarity_between
from splatmorph.geometry.quaternions import matrices_from_axis_angles
from splatmorph.geometry.similarity import Similarity
from splatmorph.landmarks import Landmarks

FLOWS: dict[str, dict[str, Any]] = {
    "spline": {"kind": "node"},
    "siren": {"kind": "node", "field": "siren"},
    "ncf": {"kind": "ncf"},
    "tps": {"kind": "tps"},
}
Grid = tuple[tuple[int, ...], tuple[float, ...], tuple[int, ...]]
"""Degrees, scales, and shifts in R."""
WHOLE: Grid = ((0, 45, 90, 150, 179, 180), (1e-3, 1, 1e3), (0, 1, 10))
CORNERS: Grid = ((0, 90, 180), (1e-3, 1e3), (0, 10))


def worst(options: dict[str, Any], source: Landmarks, target: Landmarks) -> float:
    """The worst miss of a landmark, as a part of the landmarks' box."""
    p, q, names = source.match(target)
    frame = similarity_between(p, q)
    flow = make_flow(**options)
    report = fit(flow, Landmarks(p, names), Landmarks(q, names).moved(frame.inverse()))
    return next(iter(report.errors.values())) / (2 * report.scale)


def cells(grid: Grid, radius: float) -> Iterator[tuple[str, Similarity]]:
    """What is done to the target, in words and as a similarity; no turn is about no axis."""
    for axis, degrees, scale, shift in product(range(3), *grid):
        if degrees == 0 and axis > 0:
            continue
        about = torch.eye(3, dtype=torch.float64)[axis]
        turn = matrices_from_axis_angles(torch.deg2rad(torch.tensor(float(degrees))) * about)
        moved = Similarity(turn, scale, shift * radius * scale * torch.ones(3))
        yield f"{degrees}° about {'xyz'[axis]}, × {scale:g}, {shift} R", moved


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--flows", nargs="*", choices=list(FLOWS), default=list(FLOWS))
    parser.add_argument("--corners", action="store_true")
    options = parser.parse_args()
    pair = head(options.data, "james", "status")
    radius = float((pair.target.points - pair.target.points.mean(0)).norm(dim=1).max())
    grid = CORNERS if options.corners else WHOLE
    print("| flow | worst miss at rest | cells | largest ratio to it | where |")
    print("|---|---|---|---|---|")
    for name in options.flows:
        rest = worst(FLOWS[name], pair.source, pair.target)
        ratios = {
            cell: worst(FLOWS[name], pair.source, pair.target.moved(done)) / rest
            for cell, done in cells(grid, radius)
        }
        where = max(ratios, key=lambda cell: ratios[cell])
        told = f"{rest:.2e} | {len(ratios)} | {ratios[where]:.3f} | {where}"
        print(f"| {name} | {told} |", flush=True)


if __name__ == "__main__":
    main()
