"""What a video waits for: warping many splats through many frames.

    python benchmarks/warping.py [--splats 200000] [--frames 120]

Beside the kernels runs their plain torch twin; the error is that of the dense output against
1 000 Runge-Kutta steps a unit of t in double precision, at some of the splats. Prints Markdown;
best of three.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from typing import Any

import torch

from renderer.cpp import plain_twins
from splatmorph.fitting import FitConfig, fit
from splatmorph.flows import Node, make_flow
from splatmorph.flows.node import runge_kutta
from splatmorph.landmarks import Landmarks

SPLATS, FRAMES = 200_000, 120
REFERENCE_STEPS = 1000
CHECKED = 500
ENOUGH = 5.0
"""Seconds after which nothing is timed again."""
FLOWS: dict[str, dict[str, Any]] = {
    "node, spline": {"kind": "node"},
    "node, siren 128×128": {"kind": "node", "field": "siren"},
    "ncf": {"kind": "ncf"},
    "tps": {"kind": "tps"},
}


def landmarks(count: int = 250) -> tuple[Landmarks, Landmarks]:
    """A stretched and bent cloud, moving by about a tenth of its box."""
    generator = torch.Generator().manual_seed(0)
    source = torch.rand(count, 3, generator=generator, dtype=torch.float64) * 2 - 1
    return Landmarks(source), Landmarks(source + 0.15 * torch.sin(3 * source.roll(1, 1)))


def best(action: Callable[[], object]) -> float:
    """Least wall time of ``action`` in three goes, or in one that takes long."""
    taken: list[float] = []
    while len(taken) < 3 and sum(taken) < ENOUGH:
        begun = time.perf_counter()
        action()
        taken.append(time.perf_counter() - begun)
    return min(taken)


def dense_error(flow: Node, x: torch.Tensor, times: list[float]) -> float:
    """Largest distance of the trajectory from the reference, frame units."""
    chosen = x[:: len(x) // CHECKED]
    few = times[:: max(1, len(times) // 5)]
    unit = flow.to_unit(chosen.double())
    path = flow.trajectory(x, few)[:, :: len(x) // CHECKED]
    worst = 0.0
    for moved, t in zip(path, few, strict=True):
        truth = runge_kutta(flow.field, unit, t, max(1, round(abs(t) * REFERENCE_STEPS)))
        worst = max(worst, float((flow.to_unit(moved.double()) - truth).norm(dim=1).max()))
    return worst


def table(splats: int, frames: int) -> Iterator[str]:
    """Seconds for a video and for one frame, by flow."""
    generator = torch.Generator().manual_seed(1)
    x = torch.rand(splats, 3, generator=generator) * 2.2 - 1.1
    times = torch.linspace(0, 1, frames).tolist()
    yield (
        f"| {splats:,} splats, {torch.get_num_threads()} threads | steps "
        f"| {frames} frames, s | one frame, s | plain torch, one frame, s | error |"
    )
    yield "|---|---|---|---|---|---|"
    for name, made in FLOWS.items():
        flow = make_flow(**made)
        fit(flow, *landmarks(), FitConfig(steps=100 if made["kind"] == "ncf" else None))
        flow.trajectory(x[:4000], [0.5])  # compiled, or read from the cache
        many = best(lambda f=flow: f.trajectory(x, times))
        one = best(lambda f=flow: f(x, 1.0))
        cells = ["-", f"{many:.2f}", f"{one:.3f}", "-", "-"]
        if isinstance(flow, Node):
            with plain_twins():
                cells[3] = f"{best(lambda f=flow: f(x, 1.0)):.2f}"
            cells[0], cells[4] = str(flow.steps), f"{dense_error(flow, x, times):.1e}"
        yield f"| {name} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--splats", type=int, default=SPLATS)
    parser.add_argument("--frames", type=int, default=FRAMES)
    options = parser.parse_args()
    for line in table(options.splats, options.frames):
        print(line, flush=True)


if __name__ == "__main__":
    main()
