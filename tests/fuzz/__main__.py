"""``python -m tests.fuzz``: damage files and read them, for so long or so many.

It ends with 1 where a reader did anything else than read or refuse in one line; the files that
made it do so are kept.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from tests.fuzz.engine import campaign, clear
from tests.fuzz.readers import READERS


def main() -> int:
    """Run, print each fault once, and say how many files were tried."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, help="for so long at most")
    parser.add_argument("--count", type=int, help="so many files at most; 20000 if neither")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", action="append", choices=READERS, help="only this; repeat")
    parser.add_argument("--out", type=Path, default=Path("fuzz-out"), help="emptied first")
    asked = parser.parse_args()
    most = asked.count or (float("inf") if asked.minutes else 20_000)
    end = time.monotonic() + 60 * (asked.minutes or float("inf"))
    seen: set[tuple[str, str]] = set()
    faults = tried = 0
    for fault in campaign(clear(asked.out), asked.seed, asked.reader or list(READERS)):
        tried += 1
        if fault is not None:
            faults += 1
            kind = (fault.reader, fault.what[:60])
            if kind not in seen:
                seen.add(kind)
                print(f"{fault.reader}: {fault.what}\n  {fault.file}", flush=True)
        if tried >= most or time.monotonic() > end:
            break
    print(f"{tried} files, {faults} faults of {len(seen)} kinds (seed {asked.seed})")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
