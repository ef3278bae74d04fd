"""Whatever the terminal is, and whatever is sent to the process: work done is done, in one line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from splatmorph import io
from splatmorph.gaussians import Gaussians
from splatmorph.landmarks import Landmarks

ROOT = Path(__file__).parents[2]
COMMAND = [sys.executable, "-m", "splatmorph"]


@pytest.fixture(scope="module")
def pair(
    make_gaussians: Callable[..., Gaussians], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """A folder with two splats and their landmarks."""
    folder = tmp_path_factory.mktemp("pair")
    for seed, name in enumerate(("a", "b")):
        io.write(folder / f"{name}.ply", make_gaussians(60, 0, seed))
        points = torch.rand(8, 3, generator=torch.Generator().manual_seed(seed)) - 0.5
        Landmarks(points, tuple("abcdefgh")).write(folder / f"{name}.landmarks.json")
    return folder


def _environment(**more: str) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", **more}


@pytest.mark.parametrize("encoding", ["ascii", pytest.param("cp1252", marks=pytest.mark.long)])
def test_terminals_without_arrows(pair: Path, encoding: str) -> None:
    done = subprocess.run(
        [*COMMAND, "fit", "a.ply", "b.ply", "-o", f"{encoding}.run"],
        cwd=pair,
        env=_environment(PYTHONIOENCODING=encoding),
        capture_output=True,
        check=False,
    )
    # 3: random landmarks may be missed.
    assert done.returncode in (0, 3)
    assert b"a -> b" in done.stdout


@pytest.mark.parametrize("encoding", ["", pytest.param("cp1252", marks=pytest.mark.long)])
def test_a_locale_without_letters_and_a_name_that_steers_the_terminal(
    pair: Path, tmp_path: Path, encoding: str
) -> None:
    odd = tmp_path / "Größe\n\x1b[2J :bomb: →.ply"
    odd.write_bytes((pair / "a.ply").read_bytes())
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    for arguments in (["inspect", str(odd)], ["view", str(odd), "-o", str(tmp_path / "x.html")]):
        done = subprocess.run(
            [*COMMAND, *arguments],
            env=_environment(PYTHONIOENCODING=encoding, **plain),
            capture_output=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert done.stderr.count(b"\n") <= 1
        assert b"\x1b" not in done.stdout
        if arguments[0] == "inspect":
            assert b":bomb:" in done.stdout.splitlines()[0]
            assert done.stdout.splitlines()[1].strip().startswith(b"kind")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is full")
def test_output_that_is_full_or_closed(pair: Path) -> None:
    for place, code in (("> /dev/full", 1), (">&-", 0), ("2>&- >&-", 0)):
        done = subprocess.run(
            ["sh", "-c", f'"$0" -m splatmorph inspect a.ply {place}', sys.executable],
            cwd=pair,
            env=_environment(),
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == code, place
        assert done.stderr.count("\n") <= 1
        assert "Exception" not in done.stderr


def test_a_line_break_in_a_name_breaks_no_header(pair: Path) -> None:
    name = "two\nlines\x07.ply"
    io.write(pair / name, io.read(pair / "a.ply"), [f"source={name}"])
    assert b"comment source=two?lines?.ply\n" in (pair / name).read_bytes()
    assert len(io.read(pair / name)) == 60


@pytest.mark.parametrize(
    ("out", "sent"), [("a.mp4", "SIGTERM"), ("frames", "SIGINT"), ("frames", "SIGKILL")]
)
def test_a_command_that_is_stopped_leaves_nothing_behind(
    pair: Path, tmp_path: Path, out: str, sent: str
) -> None:
    render = [*COMMAND, "render", str(pair / "a.ply"), "--size", "128x128", "-o", out]
    process = subprocess.Popen(
        [*render, "--frames", "5000"],
        cwd=tmp_path,
        env=_environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        # Tests that run in the background ignore it, and so would the command.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    begun = time.monotonic()
    while not list(tmp_path.iterdir()) and time.monotonic() < begun + 60:
        time.sleep(0.02)
    process.send_signal(getattr(signal, sent))
    _, said = process.communicate(timeout=60)
    assert process.returncode == {"SIGINT": 130, "SIGTERM": 143, "SIGKILL": -9}[sent]
    assert not (tmp_path / out).exists()
    if sent == "SIGKILL":
        # What it left is removed by the next command that writes there.
        again = [*COMMAND, "render", str(pair / "a.ply"), "--size", "32x32", "-o", "next.png"]
        subprocess.run(again, cwd=tmp_path, env=_environment(), check=True, capture_output=True)
        (tmp_path / "next.png").unlink()
    else:
        assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_while_a_library_loads_ends_with_our_code(tmp_path: Path) -> None:
    (tmp_path / "interrupted.py").write_text(
        "from splatmorph import app\n"
        "def run():\n"
        "    try:\n"
        "        exec('import signal, time; signal.raise_signal(signal.SIGINT); time.sleep(9)')\n"
        "    except KeyboardInterrupt:\n"
        "        return app.console.INTERRUPTED\n"
        "app.run = run\n"
        "app.main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "interrupted"],
        cwd=tmp_path,
        env=_environment(),
        check=False,
        capture_output=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert done.returncode == 130, done.stderr
