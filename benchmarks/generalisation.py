"""How far off a warp is between its landmarks: fitted on few points, scored on the others.

    python benchmarks/generalisation.py DATA [--pairs 10] [--seed 0]

DATA is the folder of real inputs (meshes/, heads/). RBF displacements, which are no flows, are
the mark to reach. Prints Markdown; errors are mean distances in mm.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import torch
from pairs import Pair, heads, persons
from scipy.interpolate import RBFInterpolator

from splatmorph.fitting import FitConfig, fit
from splatmorph.flows import make_flow

RBF = ("linear", "thin_plate_spline", "cubic")
FLOWS: dict[str, tuple[dict[str, Any], FitConfig]] = {
    "NODE, spline field (default)": ({"kind": "node"}, FitConfig()),
    "the same, smoothing 0": ({"kind": "node"}, FitConfig(smoothing=0.0)),
    "NODE, SIREN finished by a spline": ({"kind": "node", "field": "siren"}, FitConfig()),
    "NODE, SIREN, Hessian energy": (
        {"kind": "node", "field": "siren", "base": "affine"},
        FitConfig(energy="hessian"),
    ),
    "NODE, SIREN, Jacobian energy (the paper's)": (
        {"kind": "node", "field": "siren", "base": "affine"},
        FitConfig(energy="jacobian"),
    ),
    "NCF": ({"kind": "ncf"}, FitConfig()),
    "ifmorph": ({"kind": "ifmorph"}, FitConfig()),
}


def off(pair: Pair, warp: Callable[[torch.Tensor], torch.Tensor]) -> float:
    """Mean distance from the truth, mm."""
    assert pair.held_source is not None
    assert pair.held_target is not None
    return float((warp(pair.held_source) - pair.held_target).norm(dim=1).mean()) * pair.unit_mm


def displaced(pair: Pair, kernel: str) -> float:
    """``off`` of scipy's RBF displacement with a linear part."""
    p, q, _ = pair.source.match(pair.target)
    interpolator = RBFInterpolator(p.numpy(), (q - p).numpy(), kernel=kernel, degree=1)
    return off(pair, lambda x: x + torch.from_numpy(interpolator(x.numpy())))


def flowed(pair: Pair, options: dict[str, Any], config: FitConfig) -> float:
    """``off`` of a fitted flow."""
    flow = make_flow(dim=pair.source.dim, **options)
    fit(flow, pair.source, pair.target, config)
    return off(pair, lambda x: flow(x, 1.0))


def rows(
    groups: Sequence[Sequence[Pair]], names: Sequence[str]
) -> Iterator[tuple[str, list[float]]]:
    """A row a method: its mean over the pairs of each group."""
    methods: dict[str, Callable[[Pair], float]] = {"nothing": lambda pair: off(pair, lambda x: x)}
    for kernel in RBF:
        methods[f"RBF displacement, {kernel}"] = lambda pair, k=kernel: displaced(pair, k)
    for name in names:
        methods[name] = lambda pair, chosen=FLOWS[name]: flowed(pair, *chosen)
    for name, method in methods.items():
        yield name, [sum(map(method, group)) / len(group) for group in groups]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", choices=list(FLOWS), default=list(FLOWS))
    options = parser.parse_args()
    groups = [list(persons(options.data, options.pairs, options.seed)), heads(options.data)]
    print(f"| mean error, mm | {options.pairs} pairs of persons, 68 landmarks | 2 pairs of heads |")
    print("|---|---|---|")
    for name, values in rows(groups, options.only):
        print(f"| {name} | {values[0]:.3f} | {values[1]:.3f} |", flush=True)


if __name__ == "__main__":
    main()
