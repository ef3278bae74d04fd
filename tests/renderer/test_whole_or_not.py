"""Videos that can be played, or none; nothing of killed processes is left, nothing of live ones."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest

from renderer import OutputError, write_video
from renderer.beside import MARK, beside, remove_strays


def _frames(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.integers(0, 255, (64, 64, 3), np.uint8) for _ in range(count)]


@pytest.mark.parametrize("name", ["a.mp4", "a.mov", "a.mkv", "a.webm", "a:b.mp4"])
def test_every_video_holds_its_frames(tmp_path: Path, name: str) -> None:
    write_video(tmp_path / name, _frames(5), 10)
    assert imageio_ffmpeg.count_frames_and_secs(str(tmp_path / name))[0] == 5
    head = (tmp_path / name).read_bytes()[:64]
    assert (b"webm" in head) == name.endswith(".webm")


FULL = """
import resource, signal, sys
import numpy as np
from renderer import OutputError, write_video
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
rng = np.random.default_rng(0)
frames = (rng.integers(0, 255, (128, 128, 3), np.uint8) for _ in range(20))
try:
    write_video(sys.argv[1], frames, 10)
except OutputError as error:
    print(error)
"""


@pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="no limit on sizes of files")
@pytest.mark.parametrize("name", ["a.mp4", "a.webm", "a.gif", "frames"])
def test_a_disk_that_fills_leaves_what_was_there(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    write_video(path, _frames(2), 10)
    before = path.stat().st_mtime_ns
    done = subprocess.run(
        [sys.executable, "-c", FULL, path], capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    assert done.stdout.count("\n") == 1
    assert path.stat().st_mtime_ns == before
    assert [file.name for file in tmp_path.iterdir()] == [name]


KILLED = """
import os, signal, sys
from pathlib import Path
from renderer.beside import beside
with beside(Path(sys.argv[1])) as partial:
    partial.mkdir() if sys.argv[2] == "folder" else partial.touch()
    os.kill(os.getpid(), getattr(signal, sys.argv[3]))
"""


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_what_a_killed_process_left_is_removed(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.x"
    done = subprocess.run([sys.executable, "-c", KILLED, path, kind, "SIGKILL"], check=False)
    assert done.returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 1
    remove_strays(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_strays_go_wherever_one_stands_and_whatever_their_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("one", "two"):
        folder = tmp_path / name
        folder.mkdir()
        monkeypatch.chdir(folder)
        with beside(Path("a.x")) as partial:
            stray = Path(partial.name.replace(str(os.getpid()), "9" * 30))
            partial.touch()
        stray.touch()
        monkeypatch.setattr("renderer.beside._cleaned", set())
        with beside(Path("a.x")) as partial:
            partial.touch()
        assert [file.name for file in folder.iterdir()] == ["a.x"]
    stray.touch()
    monkeypatch.setattr("renderer.beside._cleaned", {tmp_path / "one"})
    with beside(Path("a.x")) as partial:
        partial.touch()
    assert not stray.exists()


def test_what_a_live_process_writes_is_left_alone(tmp_path: Path) -> None:
    strange = tmp_path / f"{MARK}{os.getppid()}-elsewhere-a.x"
    strange.touch()
    with beside(tmp_path / "a.x") as partial:
        partial.touch()
        remove_strays(tmp_path)
        assert partial.exists()
        assert strange.exists()


def test_an_unknown_extension_is_refused_before_any_frame(tmp_path: Path) -> None:
    def frames() -> object:
        raise AssertionError
        yield

    with pytest.raises(OutputError, match="expected"):
        write_video(tmp_path / "a.avi2", frames())  # type: ignore[arg-type]
