"""What a second worker is worth to ``splatmorph batch``, and what killing workers does to it.

    python benchmarks/workers.py FACES [--pairs 200] [--rounds 3] [--kills 3]

FACES as for ``frll.py``. In each round the pairs are morphed by one worker, then by two, a thread
each. Others at work on the machine slow two workers more than one: so what they took of its cores
is told beside. Then two workers do it once more while one of them is killed by SIGKILL now and
again, and a plain process does it: pictures are compared bit for bit. Prints Markdown.
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
from frll import draw_pairs, read_faces, write_table


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("faces", type=Path)
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--kills", type=int, default=3)
    parser.add_argument("--size", default="256x256", help="of the pictures that are made")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        pairs = draw_pairs(read_faces(asked.faces), asked.pairs)
        batch = Batch(write_table(folder, pairs), asked.size, len(pairs))
        print(f"{len(pairs)} pairs, {os.cpu_count()} cores\n")
        gains = []
        if asked.rounds:
            print(
                "| workers | wall, s | own CPU, s | others' CPU, s |\n|---|---|---|---|", flush=True
            )
        for number in range(asked.rounds):
            walls = [batch.timed(folder / f"{number}-{workers}", workers) for workers in (1, 2)]
            gains.append(walls[0] / walls[1])
        if gains:
            print(f"\nspeed-up: {', '.join(f'{gain:.2f}' for gain in gains)}\n", flush=True)
        if asked.kills:
            plain, killed = folder / "plain", folder / "killed"
            batch.run(plain, [])
            deaths = batch.killing(killed, asked.kills)
            print(f"{deaths} workers killed: {compared(plain, killed)}")
            for one in sorted(folder.glob("[0-9]-[12]")):
                print(f"{one.name}: {compared(plain, one)}")


class Batch:
    """A table that is worked through anew by each call."""

    def __init__(self, table: Path, size: str, pairs: int) -> None:
        self.pairs = pairs
        self.words = [sys.executable, "-m", "splatmorph", "batch", str(table)]
        self.words += ["--image", f"--size {size}"]

    def start(self, out: Path, words: list[str]) -> subprocess.Popen[str]:
        """Begin, with a line on stderr for each row that is done."""
        return subprocess.Popen(
            [*self.words, "-o", str(out), *words],
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, out: Path, words: list[str]) -> None:
        """Work through the table."""
        with self.start(out, words) as process:
            said = process.stderr.read()
        if process.returncode:
            raise SystemExit(said.splitlines()[-1])

    def timed(self, out: Path, workers: int) -> float:
        """Seconds by so many workers; prints them."""
        before, own, wall = busy(), spent(), time.perf_counter()
        self.run(out, ["--workers", str(workers)])
        wall, own = time.perf_counter() - wall, spent() - own
        print(f"| {workers} | {wall:.1f} | {own:.1f} | {busy() - before - own:.1f} |", flush=True)
        return wall

    def killing(self, out: Path, kills: int) -> int:
        """Work by two workers, one of which is killed at evenly spaced rows; how many were."""
        at = {self.pairs * (i + 1) // (kills + 1) for i in range(kills)}
        deaths = 0
        with self.start(out, ["--workers", "2"]) as process:
            for line in process.stderr:
                count = line.partition("/")[0]
                if count.isdecimal() and int(count) in at:
                    random.Random(int(count)).choice(list(workers_of(process.pid))).kill()
                    deaths += 1
        if process.returncode:
            raise SystemExit(f"the batch ends with {process.returncode}")
        return deaths


def workers_of(batch: int) -> Iterator[psutil.Process]:
    """The worker processes that a batch has started."""
    for child in psutil.Process(batch).children():
        if "spawn_main" in " ".join(child.cmdline()):
            yield child


def busy() -> float:
    """Seconds that all cores have been at work, whoever's."""
    times = psutil.cpu_times()
    return sum(times) - times.idle - getattr(times, "iowait", 0)


def spent() -> float:
    """CPU seconds of the processes that have ended."""
    times = os.times()
    return times.children_user + times.children_system


def compared(plain: Path, other: Path) -> str:
    """Whether both folders hold the same pictures."""
    names = {path.name for folder in (plain, other) for path in folder.glob("*.png")}
    ends = [{n: (f / n).read_bytes() for n in names if (f / n).exists()} for f in (plain, other)]
    differ = sorted(name for name in names if ends[0].get(name) != ends[1].get(name))
    if differ:
        return f"{len(differ)} of {len(names)} pictures differ: {', '.join(differ[:3])}"
    return f"{len(names)} pictures, the same bits as one process makes"


if __name__ == "__main__":
    main()
