"""What large splats take from beginning to end, in time and memory.

    python benchmarks/scaling.py [--count 1000000] [--blend union] [--steps inspect fit render …]

Writes two head-like splats of SH degree 3, so many each, with 60 landmarks beside them, into a
folder of its own, and works through them as a user would: each command is a process. By row: wall
time, processor time, and the most memory that the process has had, in all and beside what the
arrays of its inputs take. Prints Markdown. Kernels are compiled before.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

FLOATS = 59
"""A splat of SH degree 3."""


def write_pair(folder: Path, count: int) -> None:
    """Two heads, the second one's landmarks moved by about a twelfth of its height."""
    import morphing
    import torch

    from splatmorph import io
    from splatmorph.landmarks import Landmarks

    generator = torch.Generator().manual_seed(0)
    points = torch.rand(60, 3, dtype=torch.float64, generator=generator) - 0.5
    moved = points + 0.08 * torch.sin(4 * points.roll(1, 1))
    names = tuple(f"point {i}" for i in range(len(points)))
    files = folder / "a.ply", folder / "b.ply"
    for seed, (file, marks) in enumerate(zip(files, (points, moved), strict=True)):
        io.write(file, morphing.splat(count, seed))
        Landmarks(marks, names).write(folder / f"{file.stem}.landmarks.json")


def measured(command: list[str], folder: Path) -> tuple[float, float, float]:
    """Wall seconds, processor seconds and bytes at most of ``splatmorph`` so called."""
    began = time.perf_counter()
    with (folder / "said.txt").open("w") as said:
        process = subprocess.Popen(
            [sys.executable, "-m", "splatmorph", *command], cwd=folder, stdout=said, stderr=said
        )
        _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit((folder / "said.txt").read_text())
    wall = time.perf_counter() - began
    return wall, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024.0


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--blend", default="union")
    parser.add_argument("--steps", nargs="+")
    options = parser.parse_args()
    blend = ["--blend", options.blend]
    commands = {
        "inspect": ["inspect", "a.ply"],
        "fit": ["fit", "a.ply", "b.ply", "-o", "run"],
        "render": ["render", "run", "--size", "1920x1080", "--frames", "24", "-o", "a.mp4", *blend],
        "export": ["export", "run", "--t", "0.5", "-o", "half.ply", *blend],
        "page": ["view", "run", "-o", "page.html", *blend],
    }
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        # A process begins with the memory of the one that it is forked from.
        writer = multiprocessing.get_context("spawn").Process(
            target=write_pair, args=(folder, options.count)
        )
        writer.start()
        writer.join()
        print(f"{options.count:,} + {options.count:,} splats, blend {options.blend}", flush=True)
        print("| command | wall, s | CPU, s | GB | beside the inputs |\n|---|---|---|---|---|")
        for name in options.steps or commands:
            wall, cpu, most = measured(commands[name], folder)
            inputs = options.count * FLOATS * 4 * (1 if name == "inspect" else 2)
            cells = f"{wall:.1f} | {cpu:.1f} | {most / 1e9:.2f} | {(most - inputs) / 1e9:.2f}"
            print(f"| `{name}` | {cells} |", flush=True)


if __name__ == "__main__":
    main()
