"""What a frame of a morph costs beside its drawing.

    python benchmarks/morphing.py [--counts 100000 1000000] [--frames 6] [--blend union]

Two head-like splats of SH degree 3, so many each, morph by a spline flow (calibrated, full) into
pictures of 1920x1080. By row: seconds to prepare, processor time and wall time of making a frame
and of drawing it (both medians), their ratio, and the most memory that the process has had,
beside what the inputs take. Prints Markdown.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import time

import rasterize as scenes
import torch

from renderer.cpp import plain_twins
from splatmorph.fitting import fit
from splatmorph.flows import Flow, make_flow
from splatmorph.gaussians import Gaussians
from splatmorph.landmarks import Landmarks
from splatmorph.morph import Morph
from splatmorph.rendering import bounds, render, turntable

SIZE = (1920, 1080)


def splat(count: int, seed: int) -> Gaussians:
    """A head of ``benchmarks/rasterize.py`` as it is stored."""
    scene = {name: torch.from_numpy(array) for name, array in scenes.head(count, seed).items()}
    return Gaussians(
        means=scene["means"],
        quats=scene["quats"],
        log_scales=scene["scales"].log(),
        opacity_logits=scene["opacities"].clamp(1e-4, 1 - 1e-4).logit(),
        sh=scene["sh"],
    )


def bent() -> Flow:
    """A flow that moves the head by about a twelfth of its height."""
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(60, 3, dtype=torch.float64, generator=generator) - 0.5
    flow = make_flow("node")
    fit(flow, Landmarks(points), Landmarks(points + 0.08 * torch.sin(4 * points.roll(1, 1))))
    return flow


def row(count: int, frames: int, blend: str, flow: Flow) -> list[str]:
    """Cells of the table for two splats of ``count``."""
    morph = Morph(splat(count, 0), splat(count, 1), flow, blend=blend)
    inputs = 2 * count * 59 * 4
    camera = turntable(bounds(morph.source, morph.target), 1, size=SIZE)[0]
    spent: list[list[float]] = []
    began = time.perf_counter()
    made = morph.sequence([(i + 1) / (frames + 2) for i in range(frames + 1)])
    render(next(made), camera)
    prepared = time.perf_counter() - began
    for _ in range(frames):
        marks = [(time.process_time(), time.perf_counter())]
        frame = next(made)
        marks.append((time.process_time(), time.perf_counter()))
        render(frame, camera)
        marks.append((time.process_time(), time.perf_counter()))
        spent.append([marks[i + 1][k] - marks[i][k] for i in (0, 1) for k in (0, 1)])
    cpu, wall, drawn_cpu, drawn_wall = (
        1e3 * statistics.median(column) for column in zip(*spent, strict=True)
    )
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return [
        f"{count:,} + {count:,}",
        f"{prepared:.1f}",
        *(f"{ms:.0f}" for ms in (cpu, wall, drawn_cpu, drawn_wall)),
        f"{cpu / drawn_cpu:.2f}",
        f"{(most - inputs) / 1e9:.1f}",
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--counts", type=int, nargs="+", default=[100_000, 1_000_000])
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--blend", default="union")
    parser.add_argument("--plain", action="store_true", help="without any C++, the first only")
    options = parser.parse_args()
    print("| splats | prepare, s | morph, CPU ms | wall | drawing, CPU ms | wall | ratio | GB |")
    print("|---|---|---|---|---|---|---|---|")
    flow = bent()
    for count in options.counts:
        print(f"| {' | '.join(row(count, options.frames, options.blend, flow))} |", flush=True)
    if options.plain:
        with plain_twins():
            cells = row(options.counts[0], 1, options.blend, flow)
        print(f"| plain: {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
