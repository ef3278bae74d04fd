"""Feeds readers with damaged files and tells what went otherwise than in one line."""

from __future__ import annotations

import gzip
import io
import json
import resource
import shutil
import signal
import time
import warnings
import zipfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

from renderer.errors import RenderError
from splatmorph.errors import SplatmorphError
from tests.fuzz.mutate import mutated
from tests.fuzz.readers import READERS, SLOW, Reader

LONGEST = 2.0
"""Seconds of the processor's, so that a busy machine is no fault."""
MEMORY = 1 << 30
"""Bytes beyond what the process has when it begins."""
PEAK = 400 << 10
"""KiB that a reading may add to the largest so far."""


@dataclass(frozen=True)
class Fault:
    """A reading that ended in another way than it should."""

    reader: str
    file: Path
    what: str


class _TooSlowError(BaseException):
    pass


def campaign(folder: Path, seed: int, names: list[str]) -> Iterator[Fault | None]:
    """Without end: what each next damaged file does, None where all is well.

    Before each reading its file is at ``folder/<reader>/damaged/``, so that it is there if the
    process dies; files of faults are kept in ``folder/faults``.
    """
    limit_memory()
    signal.signal(signal.SIGALRM, _too_slow)
    warnings.simplefilter("ignore")
    random = Random(seed)
    whole = {}
    for name in names:
        made = folder / name / "whole"
        made.mkdir(parents=True)
        whole[name] = [(path, path.read_bytes()) for path in READERS[name].files(made)]
        (folder / name / "damaged").mkdir()
    weights = [1 / SLOW.get(name, 1) for name in names]
    number = 0
    while True:
        (name,) = random.choices(names, weights)
        path, data = random.choice(whole[name])
        _, other = random.choice(whole[name])
        damaged = damage(data, other, random)
        place = folder / name / "damaged" / path.name
        place.write_bytes(damaged)
        what = complaint(READERS[name], place)
        if what is not None:
            kept = folder / "faults" / f"{name}-{seed}-{number}-{path.name}"
            kept.parent.mkdir(exist_ok=True)
            kept.write_bytes(damaged)
            yield Fault(name, kept, what)
        else:
            yield None
        number += 1
        for leftover in place.parent.iterdir():
            leftover.unlink()


def limit_memory() -> None:
    """Keep this process from taking the machine's memory."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def damage(data: bytes, other: bytes, random: Random) -> bytes:
    """A damaged file; where it is compressed, as often damaged inside."""
    if data.startswith(b"\x1f\x8b") and random.random() < 0.7:
        inner = gzip.decompress(data)
        return gzip.compress(mutated(inner, inner, random), 1)
    if data.startswith(b"PK") and random.random() < 0.7:
        return _repacked(data, random)
    return mutated(data, other, random)


def _repacked(data: bytes, random: Random) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(packed, "w") as new:
        names = old.namelist()
        chosen = random.choice(names)
        for name in names:
            inner = old.read(name)
            changed = mutated(inner, old.read(random.choice(names)), random)
            new.writestr(name, changed if name == chosen else inner)
    return packed.getvalue()


def complaint(reader: Reader, path: Path, *, refused: bool = False) -> str | None:
    """What is wrong with how ``path`` was read or refused; None if nothing is.

    ``refused``: being read at all is wrong.
    """
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begun = time.process_time()
    signal.setitimer(signal.ITIMER_REAL, 15 * LONGEST)
    try:
        reader.read(path)
        found = "it was read" if refused else None
    except (SplatmorphError, RenderError) as error:
        found = _refusal(error, path)
    except _TooSlowError:
        found = "it was still being read"
    except BaseException as error:
        found = f"{type(error).__name__}: {error}"[:300]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    seconds = time.process_time() - begun
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    if seconds > LONGEST:
        return f"{seconds:.1f} s"
    if grown > PEAK:
        return f"{grown >> 10} MB more"
    return found


def _refusal(error: Exception, path: Path) -> str | None:
    text = str(error)
    if not text.isprintable():
        return f"no one line: {text!r}"
    # A run's folder stands for its files.
    if str(path) not in text and str(path.parents[1]) not in text:
        return f"it isn't named: {text}"
    if isinstance(error.__cause__, MemoryError):
        return f"it took all memory: {text}"
    return None


def _too_slow(*_: Any) -> None:
    raise _TooSlowError


def summary(counts: Counter[str]) -> str:
    """A line of how many of each."""
    return json.dumps(dict(counts.most_common()))


def clear(folder: Path) -> Path:
    """An empty folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder
