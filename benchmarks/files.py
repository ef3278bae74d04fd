"""PLY in and out: 300 000 splats of SH degree 3, beside what plain plyfile use costs.

    python benchmarks/files.py

Medians of five. The plain way reads every property by name into its own array and, for writing,
makes one tuple a splat, as many exporters do.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData, PlyElement

from splatmorph import io
from splatmorph.gaussians import Gaussians

SPLATS = 300_000


def seconds(action: Callable[[], object], repeats: int = 5) -> float:
    """Median wall time of ``action``."""
    taken = []
    for _ in range(repeats):
        begun = time.perf_counter()
        action()
        taken.append(time.perf_counter() - begun)
    return statistics.median(taken)


def read_plainly(path: Path) -> list[np.ndarray]:
    """Every property, one by one."""
    data = PlyData.read(path)["vertex"]
    return [np.asarray(data[prop.name]).copy() for prop in data.properties]


def write_plainly(path: Path, table: np.ndarray, names: list[str]) -> None:
    """One tuple a splat."""
    records = np.array(list(map(tuple, table)), dtype=[(name, "f4") for name in names])
    PlyData([PlyElement.describe(records, "vertex")]).write(path)


def main() -> None:
    """Print the table."""
    rng = torch.Generator().manual_seed(0)
    splats = Gaussians(
        means=torch.randn(SPLATS, 3, generator=rng),
        quats=torch.randn(SPLATS, 4, generator=rng),
        log_scales=torch.randn(SPLATS, 3, generator=rng) - 5,
        opacity_logits=torch.randn(SPLATS, generator=rng) * 3,
        sh=torch.randn(SPLATS, 16, 3, generator=rng),
    )
    with tempfile.TemporaryDirectory() as folder:
        path, other = Path(folder) / "a.ply", Path(folder) / "b.ply"
        write = seconds(lambda: io.write(path, splats))
        read = seconds(lambda: io.read(path))
        data = PlyData.read(path)["vertex"].data
        names = list(data.dtype.names)
        table = np.stack([data[name] for name in names], axis=1)
        rows = {
            "read": (read, seconds(lambda: read_plainly(path))),
            "write": (write, seconds(lambda: write_plainly(other, table, names), repeats=1)),
        }
    print(f"{SPLATS:,} splats, SH degree 3")
    for what, (ours, plain) in rows.items():
        print(f"{what:6} {ours:.3f} s, plainly {plain:.3f} s: {plain / ours:.1f} times as long")


if __name__ == "__main__":
    main()
