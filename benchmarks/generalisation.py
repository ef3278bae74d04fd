"""How far off a warp is between its landmarks: fitted on few points, scored on the others.

    python benchmarks/generalisation.py DATA [--pairs 10] [--seed 0] [--noisy]

DATA is the folder of real inputs (meshes/, heads/). RBF displacements, which are no flows, are
the mark to reach. With --noisy, on landmarks that are noisy, exchanged, few or all but planar: the
smoothing that a fit chooses against a fixed one, and which pairs it names. Prints Markdown; errors
are mean distances in mm.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from pairs import Pair, heads, persons
from scipy.interpolate import RBFInterpolator

from splatmorph.fitting import FitConfig, FitReport, fit
from splatmorph.fitting.choice import suspects
from splatmorph.fitting.report import SMOOTHING
from splatmorph.flows import Flow, make_flow
from splatmorph.landmarks import Landmarks

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
    flow, _ = fitted(pair, options, config)
    return off(pair, lambda x: flow(x, 1.0))


def fitted(pair: Pair, options: dict[str, Any], config: FitConfig) -> tuple[Flow, FitReport]:
    """A flow and how its fit went."""
    flow = make_flow(dim=pair.source.dim, **options)
    return flow, fit(flow, pair.source, pair.target, config)


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


FEATURES = (8, 30, 31, 35, 36, 39, 42, 45, 48, 51, 54, 57)
"""Of the 68: chin, nose, corners of eyes and mouth, lips."""
MANY = 254
"""Landmarks of the dense case, spread over the face's vertices."""


def marked(pair: Pair, p: torch.Tensor, q: torch.Tensor) -> Pair:
    """The pair with other landmarks."""
    return replace(pair, source=Landmarks(p), target=Landmarks(q))


def many(pair: Pair) -> Pair:
    """The pair with landmarks all over the face, which the truth then leaves out."""
    assert pair.held_source is not None
    assert pair.held_target is not None
    chosen = torch.linspace(0, len(pair.held_source) - 1, MANY).long()
    rest = torch.ones(len(pair.held_source), dtype=torch.bool)
    rest[chosen] = False
    ends = pair.held_source, pair.held_target
    marks = (Landmarks(end[chosen]) for end in ends)
    return Pair(pair.name, *marks, *(end[rest] for end in ends), unit_mm=pair.unit_mm)


def spoilt(pair: Pair, case: str, generator: torch.Generator) -> Pair:
    """A clean pair in one of ``CASES``."""
    if case.startswith("254"):
        pair = many(pair)
    p, q = pair.source.points, pair.target.points
    if "noise" in case:
        width = float(case.split()[-3]) / pair.unit_mm
        p, q = (
            points + width * torch.randn(points.shape, generator=generator, dtype=points.dtype)
            for points in (p, q)
        )
    if "swapped" in case:
        i, j = torch.randperm(len(q), generator=generator)[:2].tolist()
        q = q.clone()
        q[[i, j]] = q[[j, i]]
    if "features" in case:
        p, q = p[list(FEATURES)], q[list(FEATURES)]
    return marked(pair, p, q)


CASES = (
    "68 clean",
    "254 clean",
    "68, 1 mm noise",
    "68, 2 mm noise",
    "254, 1 mm noise",
    "68, any two swapped",
    "12 features",
)


def trust(pairs: Sequence[Pair], seed: int) -> Iterator[list[str]]:
    """A row a case: RBF, the fixed smoothing, the rule, and what that changed."""
    node = {"kind": "node"}
    for case in CASES:
        generator = torch.Generator().manual_seed(seed)
        these = [spoilt(pair, case, generator) for pair in pairs]
        rbf = [displaced(pair, "linear") for pair in these]
        fixed = [flowed(pair, node, FitConfig(smoothing=SMOOTHING)) for pair in these]
        chosen = [flowed(pair, node, FitConfig()) for pair in these]
        ratios = [new / old for new, old in zip(chosen, fixed, strict=True)]
        means = [sum(column) / len(column) for column in (rbf, fixed, chosen)]
        yield [
            case,
            *(f"{mean:.2f}" for mean in means),
            f"{100 * (means[2] / means[1] - 1):+.0f} %",
            f"{sum(r > 1.05 for r in ratios)} / {sum(r < 0.95 for r in ratios)}",
        ]


def in_frame(pair: Pair) -> tuple[torch.Tensor, torch.Tensor]:
    """Matched landmarks as a fit sees them, in [-1, 1]."""
    p, q, _ = pair.source.match(pair.target)
    both = torch.cat([p, q])
    middle, half = (both.amax(0) + both.amin(0)) / 2, (both.amax(0) - both.amin(0)).max() / 2
    return (p - middle) / half, (q - middle) / half


def named(pairs: Sequence[Pair], case: str, seed: int) -> str:
    """How many pairs have landmarks that a fit would name, and how many landmarks those are."""
    generator = torch.Generator().manual_seed(seed)
    found = [len(suspects(*in_frame(spoilt(pair, case, generator)))) for pair in pairs]
    return f"| {case} | {sum(map(bool, found))} of {len(found)} | {sum(found)} |"


def planar(noise: float, config: FitConfig) -> list[float]:
    """How far off a warp is .2 above 8 landmarks of a plane of size 1 that grows by a tenth."""
    missed = []
    for seed in range(10):
        generator = torch.Generator().manual_seed(seed)
        x = torch.rand(8, 3, generator=generator).double() * torch.tensor([1.0, 1, 0])
        x[:, 2] += noise * torch.randn(8, generator=generator)
        y = 1.1 * x
        y[:, 2] += noise * torch.randn(8, generator=generator)
        above = x + torch.tensor([0, 0, 0.2])
        goal = torch.cat([1.1 * above[:, :2], 1.1 * above[:, 2:]], 1)
        flow, _ = fitted(Pair("plane", Landmarks(x), Landmarks(y)), {"kind": "node"}, config)
        missed.append(float((flow(above, 1.0) - goal).norm(dim=1).mean()))
    return missed


def print_trust(data: Path, count: int, seed: int) -> None:
    """The tables of --noisy."""
    print(f"| {count} pairs of persons | RBF | λ fixed | chosen | | worse / better |")
    print("|---|---|---|---|---|---|")
    for cells in trust(list(persons(data, count, seed)), seed):
        print(f"| {' | '.join(cells)} |", flush=True)
    print("\n| 100 pairs of persons | with landmarks named | landmarks |\n|---|---|---|")
    for case in CASES:
        print(named(list(persons(data, 100, seed + 1)), case, seed), flush=True)
    print("\n| 8 points on a plane, noise | λ fixed, median and worst | chosen |\n|---|---|---|")
    for noise in (0.002, 0.005, 0.02):
        off_plane = [planar(noise, one) for one in (FitConfig(smoothing=SMOOTHING), FitConfig())]
        cells = [f"{statistics.median(one):.3f}, {max(one):.3f}" for one in off_plane]
        print(f"| {noise} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", choices=list(FLOWS), default=list(FLOWS))
    parser.add_argument("--noisy", action="store_true")
    options = parser.parse_args()
    if options.noisy:
        print_trust(options.data, options.pairs, options.seed)
        return
    groups = [list(persons(options.data, options.pairs, options.seed)), heads(options.data)]
    print(f"| mean error, mm | {options.pairs} pairs of persons, 68 landmarks | 2 pairs of heads |")
    print("|---|---|---|")
    for name, values in rows(groups, options.only):
        print(f"| {name} | {values[0]:.3f} | {values[1]:.3f} |", flush=True)


if __name__ == "__main__":
    main()
