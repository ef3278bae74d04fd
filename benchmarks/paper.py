"""The paper's tables on the data there is, as one Markdown report with plots.

    python benchmarks/paper.py DATA -o FOLDER [--quick]

DATA is the folder of real inputs (landmarks3d/, faces2d/, heads/). ``--quick`` trains for a few
steps only, to see that everything runs. What happens between the landmarks is in
benchmarks/generalisation.py.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib as mpl
import torch
import warping
from pairs import Pair, frll, head, nersemble

from renderer.cpp import plain_twins
from splatmorph.fitting import FitConfig, FitReport, fit
from splatmorph.flows import NCF, Flow, Node, make_flow
from splatmorph.flows.node import runge_kutta

mpl.use("Agg")
from matplotlib import pyplot as plt

SIREN = {"kind": "node", "field": "siren"}
PAPER = {**SIREN, "base": "affine"}
JACOBIAN, NONE = FitConfig(energy="jacobian"), FitConfig(energy="none")
METHODS: dict[str, tuple[dict[str, Any], FitConfig]] = {
    "NODE, spline (default)": ({"kind": "node"}, FitConfig()),
    "NODE, SIREN + spline": (SIREN, FitConfig()),
    "NODE, SIREN (paper's loss)": (PAPER, JACOBIAN),
    "NODE, sigmoid (paper's loss)": ({**PAPER, "activation": "sigmoid"}, JACOBIAN),
    "NCF, SIREN": ({"kind": "ncf"}, FitConfig()),
    "NCF, sigmoid": ({"kind": "ncf", "activation": "sigmoid"}, FitConfig()),
    "ifmorph": ({"kind": "ifmorph"}, FitConfig()),
    "TPS displacement": ({"kind": "tps"}, FitConfig()),
}
QUICK_STEPS = 20
INTEGRATION_STEPS = (3, 5, 7, 15)
HESSIAN_POINTS = 1000


def fitted(
    pair: Pair, options: dict[str, Any], config: FitConfig, quick: bool
) -> tuple[Flow, FitReport]:
    """A flow of these options on this pair."""
    if quick:
        config = FitConfig(steps=QUICK_STEPS, energy=config.energy)
    flow = make_flow(dim=pair.source.dim, **options)
    return flow, fit(flow, pair.source, pair.target, config)


def landmark_table(pair: Pair, fits: dict[str, tuple[Flow, FitReport]]) -> Iterator[str]:
    """The paper's landmark metric, and what it cost."""
    unit = "pixels²" if pair.source.dim == 2 else "m²"
    first = next(iter(fits.values()))[1]
    yield f"### {pair.name}, {first.landmarks} landmarks\n"
    yield (
        f"| | MSE, box² | MSE, {unit} | inverse | group | least det | first-order energy "
        "| second-order energy | fit, s |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    yield f"| nothing | {first.mse_before:.1e} | {first.mse_world_before:.1e} |||||||"
    for name, (_, r) in fits.items():
        yield (
            f"| {name} | {r.mse:.1e} | {r.mse_world:.1e} | {r.laws.inverse:.0e} "
            f"| {r.laws.group:.0e} | {r.det_min:.2f} | {r.energy_first:.3f} "
            f"| {r.energy_second:.1f} | {r.seconds:.2f} |"
        )
    yield ""


def integration_table(pair: Pair, quick: bool) -> Iterator[str]:
    """The paper's ablation of Runge-Kutta steps: largest squared error against 1 000 steps."""
    columns = {
        "SIREN, no energy": (PAPER, NONE),
        "SIREN, Jacobian energy": (PAPER, JACOBIAN),
        "spline": ({"kind": "node"}, FitConfig()),
    }
    generator = torch.Generator().manual_seed(0)
    x = torch.rand(500, pair.source.dim, generator=generator, dtype=torch.float64) * 2 - 1
    errors = {}
    for name, (options, config) in columns.items():
        flow, _ = fitted(pair, options, config, quick)
        assert isinstance(flow, Node)
        truth = runge_kutta(flow.field, x, 1.0, 1000)
        errors[name] = [
            float((runge_kutta(flow.field, x, 1.0, n) - truth).square().sum(1).max())
            for n in INTEGRATION_STEPS
        ]
    yield f"## Integration steps, {pair.name}\n"
    yield f"| steps | {' | '.join(errors)} |"
    yield "|---|" + "---|" * len(errors)
    for i, steps in enumerate(INTEGRATION_STEPS):
        yield f"| {steps} | " + " | ".join(f"{row[i]:.1e}" for row in errors.values()) + " |"
    yield ""


def thin_plate_table(pair: Pair, quick: bool) -> Iterator[str]:
    """The paper's ablation of the energy."""
    yield f"## Thin plate, {pair.name}\n"
    yield "| | energy | MSE, box² | first-order | second-order | least det |"
    yield "|---|---|---|---|---|---|"
    for name, options in (
        ("NODE", PAPER),
        ("NCF", {"kind": "ncf"}),
        ("ifmorph", METHODS["ifmorph"][0]),
    ):
        for energy, config in (("without", NONE), ("with", JACOBIAN)):
            _, r = fitted(pair, options, config, quick)
            yield (
                f"| {name} | {energy} | {r.mse:.1e} | {r.energy_first:.3f} "
                f"| {r.energy_second:.1f} | {r.det_min:.2f} |"
            )
    yield ""


def by_autograd(flow: NCF, x: torch.Tensor) -> torch.Tensor:
    """∂²Φ/∂x² at t = 1/2 by reverse differentiation, twice, of plain torch."""
    x = x.clone().requires_grad_(True)
    with plain_twins():
        y = flow.unit_forward(x, 0.5)
    rows = []
    for i in range(flow.dim):
        slope = torch.autograd.grad(y[:, i].sum(), x, create_graph=True)[0]
        rows += [
            torch.autograd.grad(slope[:, j].sum(), x, create_graph=True)[0] for j in range(flow.dim)
        ]
    return torch.stack(rows, 1)


def differentiation_table(repeats: int = 10) -> Iterator[str]:
    """Hessian of an NCF at 1 000 points, thin-plate loss and its gradient."""
    yield f"## Forward differentiation, NCF Hessian at {HESSIAN_POINTS:,} points with backward\n"
    yield "| dim | threads | autograd, ms | forward, ms | ratio | largest difference |"
    yield "|---|---|---|---|---|---|"
    all_threads = torch.get_num_threads()
    for dim, threads in product((2, 3), sorted({1, all_threads})):
        flow = make_flow("ncf", dim)
        assert isinstance(flow, NCF)
        flow.initialise(torch.Generator().manual_seed(0))
        flow.generator.fill_(0.1)
        flow.drift.fill_(0.1)
        flow.requires_grad_(True)
        x = torch.rand(HESSIAN_POINTS, dim) * 2 - 1
        ways: tuple[Callable[[], torch.Tensor], ...] = (
            lambda f=flow, x=x: by_autograd(f, x),
            lambda f=flow, x=x: f.unit_hessian(x, 0.5),
        )
        torch.set_num_threads(threads)
        taken: tuple[list[float], ...] = ([], [])
        for _ in range(repeats):
            for way, times in zip(ways, taken, strict=True):
                begun = time.perf_counter()
                way().square().mean().backward()
                times.append((time.perf_counter() - begun) * 1000)
        gap = (ways[0]().flatten() - ways[1]().flatten()).detach().abs().max()
        slow, fast = (sorted(times)[repeats // 2] for times in taken)
        yield f"| {dim} | {threads} | {slow:.1f} | {fast:.1f} | {slow / fast:.1f} | {gap:.0e} |"
    torch.set_num_threads(all_threads)
    yield ""


def draw_convergence(fits: dict[str, tuple[Flow, FitReport]], title: str, path: Path) -> None:
    """Landmark error against wall time."""
    figure, axes = plt.subplots(figsize=(7, 4.5))
    for name, (_, report) in fits.items():
        if report.history:
            seconds = [step.seconds for step in report.history]
            axes.loglog(seconds, [step.mse for step in report.history], ".-", label=name, ms=3)
    axes.set(xlabel="seconds", ylabel="mean squared landmark error, box²", title=title)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=120, bbox_inches="tight")
    plt.close(figure)


def draw_grids(pair: Pair, fits: dict[str, tuple[Flow, FitReport]], path: Path) -> None:
    """A grid in the plane carried to t = 1, with the landmarks that it should meet."""
    p, q, _ = pair.source.match(pair.target)
    low, high = p.amin(0), p.amax(0)
    lines = [
        torch.linspace(float(a), float(b), 40, dtype=torch.float64)
        for a, b in zip(low, high, strict=True)
    ]
    grid = torch.stack(torch.meshgrid(*lines, indexing="ij"), -1)
    columns = 4
    figure, all_axes = plt.subplots(
        -(-len(fits) // columns), columns, figsize=(3 * columns, 3.4 * -(-len(fits) // columns))
    )
    for axes in all_axes.flat:
        axes.set_axis_off()
    for axes, (name, (flow, _)) in zip(all_axes.flat, fits.items(), strict=False):
        moved = flow(grid.reshape(-1, 2), 1.0).reshape(grid.shape)
        axes.plot(moved[..., 0], moved[..., 1], "k-", lw=0.4)
        axes.plot(moved[..., 0].T, moved[..., 1].T, "k-", lw=0.4)
        axes.plot(*q.T, "r.", ms=2)
        axes.set_title(name, fontsize=9)
        axes.set_aspect("equal")
        axes.invert_yaxis()
    figure.savefig(path, dpi=120, bbox_inches="tight")
    plt.close(figure)


def report(data: Path, folder: Path, quick: bool) -> Iterator[str]:
    """The lines of the report; plots go into ``folder``."""
    pairs = [nersemble(data), frll(data), head(data, "james", "status")]
    yield f"# The paper's tables, on {torch.get_num_threads()} CPU threads\n"
    yield "## Landmarks\n"
    for pair in pairs:
        fits = {name: fitted(pair, *chosen, quick) for name, chosen in METHODS.items()}
        yield from landmark_table(pair, fits)
        slug = pair.name.lower().replace(" ", "-")
        draw_convergence(fits, pair.name, folder / f"convergence-{slug}.png")
        yield f"![convergence](convergence-{slug}.png)\n"
        if pair.source.dim == 2:
            draw_grids(pair, fits, folder / f"grids-{slug}.png")
            yield f"![grids](grids-{slug}.png)\n"
    yield from integration_table(pairs[0], quick)
    yield from integration_table(pairs[1], quick)
    yield from thin_plate_table(pairs[1], quick)
    yield from differentiation_table(3 if quick else 20)
    yield "## Warping\n"
    yield from warping.table(20_000 if quick else warping.SPLATS, warping.FRAMES)


def main() -> None:
    """Write the report and print it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    lines = []
    for line in report(options.data, options.out, options.quick):
        print(line, flush=True)
        lines.append(line)
    (options.out / "report.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
