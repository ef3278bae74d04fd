"""A few of the kills and full disks of ``python -m tests.fuzz.kills``."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

QUICK = ("fit", "export", "gif", "still")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="commands run in forked children")
def test_commands_that_are_stopped_or_have_no_room_leave_nothing_broken() -> None:
    only = [part for name in QUICK for part in ("--only", name)]
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz.kills", "--count", "8", "--seed", "3", *only],
        cwd=Path(__file__).parents[2],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert done.stdout == "8 disturbed, 0 wrong (seed 3)\n"
