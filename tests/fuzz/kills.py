"""``python -m tests.fuzz.kills``: stop writing commands at random times, or fill their disk.

Nothing half-written may have a final name, what is said is a line, the next command leaves no
stray, and it ends with the bits of one that wasn't disturbed.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from random import Random

from tests.fuzz.writers import Contents, Running, again, broken, commands, contents, prepare

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
GENTLE = (signal.SIGTERM, signal.SIGINT)
"""Those that a command may answer."""
CODES = (0, 1, 3, 130, 143)
"""That it may end with then: it may have been through, or have ended a fit with the best so far."""


@dataclass(frozen=True)
class Undisturbed:
    """What a command does if left alone."""

    seconds: float
    made: Contents
    same: frozenset[str]
    """The files whose bits are the same each time: times are no part of them."""


def undisturbed(arguments: list[str], folder: Path) -> Undisturbed:
    """Run it twice, the second time where it has been."""
    made, seconds = [], 0.0
    for number in range(2):
        work = folder / str(number) / "work"
        work.mkdir(parents=True)
        done = Running(arguments, work).end()
        if not done.ended_well:
            raise RuntimeError(f"{arguments}: {done}")
        made.append(contents(work))
        seconds = done.seconds
    same = {name for name in made[0] if made[0][name] == made[1].get(name)}
    return Undisturbed(seconds, made[0], frozenset(same))


def stopped(
    name: str, arguments: list[str], whole: Undisturbed, work: Path, random: Random
) -> str | None:
    """Stop the command somewhere, then let it be given again; what is wrong, or None."""
    number = random.choice(SIGNALS)
    running = Running(arguments, work)
    try:
        signal.sigtimedwait([signal.SIGUSR1], random.uniform(0, 1.1) * whole.seconds)
    finally:
        running.send(number, group=random.random() < 0.5)
    done = running.end()
    if wrong := _left(whole, work):
        return f"{number.name}: {wrong}"
    if number in GENTLE:
        if done.code not in (*CODES, -number) or "Traceback" in done.said:
            return f"{number.name}: it ended with {done.code}: {done.said[-300:]}"
        hidden = [name for name in contents(work) if "partial" in name]
        # Before it has begun the signal ends it as any process.
        if hidden and done.code != -number:
            return f"{number.name}: it left {hidden}"
    return _next(again(name, arguments), arguments, whole, work, number.name)


def filled(
    name: str, arguments: list[str], whole: Undisturbed, work: Path, random: Random
) -> str | None:
    """Let no file grow beyond a random size, then let the command be given again."""
    largest = int(2 ** random.uniform(3, 17))
    done = Running(arguments, work, largest=largest).end()
    what = f"{largest} bytes"
    if wrong := _left(whole, work):
        return f"{what}: {wrong}"
    errors = [line for line in done.said.splitlines() if "error:" in line]
    if not done.ended_well and (done.code != 1 or not errors or "bug of ours" in done.said):
        return f"{what}: it ended with {done.code}: {done.said[-300:]}"
    if "Traceback" in done.said:
        return f"{what}: {done.said[-300:]}"
    if done.ended_well and contents(work).keys() != whole.made.keys():
        return f"{what}: it ended well with {sorted(contents(work))}"
    if hidden := [name for name in contents(work) if "partial" in name]:
        return f"{what}: it left {hidden}"
    return _next(again(name, arguments), arguments, whole, work, what)


def _left(whole: Undisturbed, work: Path) -> str | None:
    if wrong := broken(work):
        return wrong
    for name, digest in contents(work).items():
        if name in whole.same and digest not in (whole.made[name], "") and "run" not in name:
            return f"{name} has other bits"
    return None


def _next(
    repeated: list[str], arguments: list[str], whole: Undisturbed, work: Path, what: str
) -> str | None:
    if contents(work).keys() == whole.made.keys():
        repeated = [*arguments, "-w"]  # nothing is left to go on with
    done = Running(repeated, work).end()
    if not done.ended_well:
        return f"{what}, then: it ended with {done.code}: {done.said[-300:]}"
    made = contents(work)
    if made.keys() != whole.made.keys():
        return f"{what}, then: {sorted(made.keys() ^ whole.made.keys())} too many or few"
    other = [name for name in whole.same if made[name] != whole.made[name]]
    return f"{what}, then: {other} have other bits" if other else broken(work)


WAYS = {"stop": stopped, "fill": filled}


def main() -> int:
    """Stop them so often, print what goes wrong, and say how many there were."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.kills", description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", action="append", help="a command; repeat")
    parser.add_argument("--way", choices=WAYS, help="only this; both in turn if not given")
    asked = parser.parse_args()
    random = Random(asked.seed)
    ways = [WAYS[asked.way]] if asked.way else list(WAYS.values())
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGUSR1])
    wrong = 0
    with tempfile.TemporaryDirectory() as place:
        base = prepare(Path(place) / "base")
        known = commands(base)
        names = asked.only or list(known)
        whole = {name: undisturbed(known[name], Path(place) / name) for name in names}
        for number in range(asked.count):
            name = names[number % len(names)]
            work = Path(place) / name / "disturbed" / "work"
            work.mkdir(parents=True)
            disturb = ways[number // len(names) % len(ways)]
            complaint = disturb(name, known[name], whole[name], work, random)
            if complaint:
                wrong += 1
                print(f"{name}: {complaint}", flush=True)
            shutil.rmtree(work.parent)
    print(f"{asked.count} disturbed, {wrong} wrong (seed {asked.seed})")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
