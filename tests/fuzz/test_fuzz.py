"""Damaged files are read or refused in one line that names them, quickly and in little memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzz.faults import FAULTS

ROOT = Path(__file__).parents[2]
CRAFTED = [(reader, name) for reader, files in FAULTS.items() for name in files]

CHECK = """
import sys, warnings
from pathlib import Path
from tests.fuzz.engine import complaint, limit_memory
from tests.fuzz.faults import FAULTS
from tests.fuzz.readers import READERS
warnings.simplefilter("ignore")
limit_memory()
for reader, files in FAULTS.items():
    folder = Path(sys.argv[1]) / reader
    folder.mkdir()
    for name, make in files.items():
        path = folder / name
        path.write_bytes(make())
        print(reader, name, complaint(READERS[reader], path, refused=True), sep="\\t", flush=True)
"""


def _python(*arguments: object) -> subprocess.CompletedProcess[str]:
    # Of its own, since its memory is limited and a crash would end the tests.
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], str]:
    """What each crafted file did, where it came to that."""
    result = _python("-c", CHECK, tmp_path_factory.mktemp("crafted"))
    assert result.returncode == 0, result.stdout[-300:] + result.stderr[-2000:]
    rows = [line.split("\t") for line in result.stdout.splitlines()]
    return {(reader, name): what for reader, name, what in rows}


@pytest.mark.parametrize(("reader", "name"), CRAFTED)
def test_what_once_did_harm_is_refused_in_a_line(
    said: dict[tuple[str, str], str], reader: str, name: str
) -> None:
    assert said[reader, name] == "None"


def test_mutations_are_read_or_refused_in_a_line(tmp_path: Path) -> None:
    # Some 12 000 where the machine is quick.
    limits = ("--count", 12_000, "--minutes", 0.25)
    result = _python("-m", "tests.fuzz", *limits, "--seed", 1, "--out", tmp_path / "out")
    assert result.returncode == 0, result.stdout + result.stderr[-2000:]
