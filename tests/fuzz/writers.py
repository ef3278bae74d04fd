"""Every command that writes, on inputs so small that it takes a moment, run in forked children."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import resource
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import torch
from PIL import Image

import splatmorph.app.batch
import splatmorph.app.export
import splatmorph.app.fit
import splatmorph.app.image
import splatmorph.app.render
import splatmorph.app.view  # noqa: F401
from splatmorph import io
from splatmorph.app import main
from splatmorph.app.console import err, out
from splatmorph.landmarks import Landmarks
from splatmorph.runs.run import MANIFEST, open_run
from tests.fuzz import seeds

SMALL = ("--size", "48x32", "--frames", "6")
COMMANDS: dict[str, tuple[str, ...]] = {
    "fit": ("fit", "{base}/a.ply", "{base}/b.ply", "-o", "n.run"),
    "train": ("fit", "{base}/a.ply", "{base}/b.ply", "-o", "m.run", "--flow=ncf", "--steps=81"),
    "chain": ("fit", *(f"{{base}}/{name}.ply" for name in "aba"), "-o", "c.run"),
    "export": ("export", "{base}/r.run", "-o", "frames", "--frames", "5"),
    "spz": ("export", "{base}/r.run", "-o", "half.spz", "--t", "0.5"),
    "mp4": ("render", "{base}/r.run", "-o", "x.mp4", *SMALL),
    "webm": ("render", "{base}/r.run", "-o", "x.webm", *SMALL),
    "gif": ("render", "{base}/r.run", "-o", "x.gif", *SMALL),
    "folder": ("render", "{base}/r.run", "-o", "pictures", *SMALL),
    "view": ("view", "{base}/r.run", "-o", "x.html"),
    "bake": ("bake", "{base}/anna", "-o", "anna.ply", "--flame", "{base}/flame"),
    "batch": ("batch", "{base}/pairs.csv", "-o", "runs"),
    "image": ("image", "{base}/left.png", "{base}/right.png", "-o", "y.mp4", *SMALL),
    "still": ("image", "{base}/left.png", "{base}/right.png", "-o", "y.png", "--size", "48x32"),
}
"""By a name of ours; ``bake`` only where there is an avatar."""

RESUMED = {"fit": "--resume", "train": "--resume", "chain": "--resume", "export": "", "batch": ""}
"""What makes a command go on where it was stopped; the others are given ``-w``."""


def prepare(base: Path) -> Path:
    """Make the inputs."""
    base.mkdir(parents=True)
    for name, seed in (("a", 0), ("b", 1)):
        io.write(base / f"{name}.ply", seeds.splats(60, seed=seed))
        points = torch.rand(8, 3, generator=torch.Generator().manual_seed(seed)) - 0.5
        Landmarks(points, tuple("abcdefgh")).write(base / f"{name}.landmarks.json")
        side = ("left", "right")[seed]
        pixels = np.random.default_rng(seed).integers(0, 255, (32, 48, 3), np.uint8)
        Image.fromarray(pixels).save(base / f"{side}.png")
        (base / f"{side}.tem").write_text(f"4\n{5 + seed} 5\n40 6\n40 25\n6 {25 + seed}\n0\n")
    (base / "pairs.csv").write_text("source,target,name\na.ply,b.ply,one\nb.ply,a.ply,two\n")
    with contextlib.suppress(ImportError):
        import synthetic_flame  # of the avatars' tests, where they are on the path

        (base / "flame").mkdir()
        synthetic_flame.write_new(base / "flame" / "flame2023.pkl")
        synthetic_flame.write_embedding(base / "flame" / "landmark_embedding_with_eyes.npy")
        synthetic_flame.write_avatar(base / "anna", splats=60)
    done = Running(["fit", "a.ply", "b.ply", "-o", "r.run"], base).end()
    assert done.ended_well, done
    return base


def commands(base: Path) -> dict[str, list[str]]:
    """The arguments by name, of those that have what they need."""
    found = {name: [part.format(base=base) for part in parts] for name, parts in COMMANDS.items()}
    if not (base / "anna").is_dir():
        del found["bake"]
    return found


def again(name: str, arguments: list[str]) -> list[str]:
    """The command that a user gives after one that was stopped."""
    more = RESUMED.get(name, "-w")
    return [*arguments, more] if more else arguments


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    """Below 0 the signal that ended it."""
    said: str
    seconds: float

    @property
    def ended_well(self) -> bool:
        """Whether it did all: 3 only says that landmarks of ours contradict one another."""
        return self.code in (0, 3)


class Running:
    """A command in a child of this process, which has loaded everything already."""

    def __init__(self, arguments: list[str], folder: Path, *, largest: int | None = None) -> None:
        """``largest``: bytes that a file may have in it."""
        self.log = folder.parent / f"{folder.name}.log"
        self.begun = time.monotonic()
        # What it says is no file of its own, which would be limited too.
        reader, writer = os.pipe()
        self.log.touch()
        self.writes_log = _forked(lambda: self._keep(reader, writer))
        os.close(reader)
        self.process = _forked(lambda: self._be(arguments, folder, writer, largest))
        os.close(writer)

    def _keep(self, reader: int, writer: int) -> None:
        os.close(writer)
        with self.log.open("wb") as kept:
            while chunk := os.read(reader, 65536):
                kept.write(chunk)

    def _be(self, arguments: list[str], folder: Path, log: int, largest: int | None) -> None:
        os.setsid()
        os.chdir(folder)
        if largest is not None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
        os.dup2(log, 1)
        os.dup2(log, 2)
        os.close(log)
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
        out.file, err.file = sys.stdout, sys.stderr
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.argv = ["splatmorph", *arguments]
        code = 98
        try:
            main()
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else 0
        except BaseException as error:
            print(f"Traceback: {error!r}", file=sys.stderr)
        with contextlib.suppress(OSError):
            sys.stderr.flush()
        os._exit(code)

    def send(self, number: int, *, group: bool = False) -> None:
        """A signal, to all that it started too where ``group``."""
        with contextlib.suppress(ProcessLookupError):
            (os.killpg if group else os.kill)(self.process, number)

    def end(self, seconds: float = 120) -> Ended:
        """Wait for it; kill it after so long."""
        while True:
            ended, status = os.waitpid(self.process, os.WNOHANG)
            taken = time.monotonic() - self.begun
            if ended:
                break
            if taken > seconds:
                self.send(signal.SIGKILL, group=True)
            time.sleep(0.002)
        os.waitpid(self.writes_log, 0)
        said = self.log.read_text(errors="replace")
        return Ended(os.waitstatus_to_exitcode(status), said, taken)


def _forked(work: Callable[[], None]) -> int:
    """The number of a child that does ``work``."""
    number = os.fork()
    if number == 0:
        try:
            work()
        finally:
            os._exit(0)
    return number


Contents = dict[str, str]
"""What lies in a folder: by relative path a digest of each file."""


def contents(folder: Path) -> Contents:
    """Every file below ``folder``, hidden ones too, and every empty folder."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file():
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
        elif not any(path.iterdir()):
            found[f"{name}/"] = ""
    return found


def broken(folder: Path) -> str | None:
    """What is no whole file of those under a final name."""
    for path in sorted(folder.rglob("*")):
        if not path.is_file() or any(
            part.startswith(".") for part in path.relative_to(folder).parts
        ):
            continue
        try:
            _whole(path)
        except Exception as error:
            return f"{path.relative_to(folder)} is broken: {error!r}"[:300]
    return None


def _whole(path: Path) -> None:
    check: Callable[[Path], object] | None = {
        ".json": lambda file: json.loads(file.read_text()),
        ".ply": io.read,
        ".spz": io.read,
        ".png": lambda file: Image.open(file).load(),
        ".gif": lambda file: Image.open(file).seek(5),
        ".mp4": _frames,
        ".webm": _frames,
        ".html": lambda file: _expect(file.read_text().rstrip().endswith("</html>")),
    }.get(path.suffix)
    if check:
        check(path)
    if path.name == MANIFEST:
        open_run(path.parent)


def _frames(path: Path) -> None:
    _expect(imageio_ffmpeg.count_frames_and_secs(str(path))[0] >= 6)


def _expect(right: bool) -> None:
    if not right:
        raise ValueError
