"""Frames to files: mp4, gif, a folder of PNGs, single pictures.

Every file is written beside its place and renamed when it is whole. A video is encoded on a
thread of its own while the next frames are made; at most ``QUEUE`` frames wait for it.
"""

from __future__ import annotations

import contextlib
import io
import queue
import re
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.beside import beside
from renderer.errors import OutputError

Frame = NDArray[np.uint8]
Sink = Callable[[Frame], None]

QUEUE = 8
FRAME = re.compile(r"frame_\d+\.png")
PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")
H264 = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-qp", "10"]
# Constant quality, at the speed that ffmpeg's manual gives for films.
VP9 = ["-c:v", "libvpx-vp9", "-pix_fmt", "yuv420p", "-crf", "24", "-b:v", "0"]
VP9 += ["-deadline", "good", "-cpu-used", "4"]
VIDEOS = (".mp4", ".mov", ".mkv", ".webm")


def to_bytes(picture: ArrayLike) -> Frame:
    """A picture as uint8: floats are taken as 0 to 1, clipped and rounded, NaN is black."""
    pixels: NDArray[Any] = np.asarray(picture)
    if pixels.dtype != np.uint8:
        pixels = (np.nan_to_num(pixels).clip(0, 1) * 255 + 0.5).astype(np.uint8)
    return pixels


def write_image(path: str | Path, rgb: ArrayLike, alpha: ArrayLike | None = None) -> Path:
    """Write one picture; the extension chooses the format.

    rgb (height, width, 3), uint8 or floats in 0 to 1. With ``alpha`` (height, width) in 0 to 1
    the picture is transparent (PNG or WebP), and ``rgb`` is taken as premultiplied, which is
    how ``rasterize`` returns it without a background. Raises OutputError.
    """
    path = Path(path)
    if path.suffix.lower() not in PICTURES:
        raise OutputError(f"{path}: expected a picture's extension, one of {', '.join(PICTURES)}")
    if alpha is None:
        pixels = to_bytes(rgb)
    else:
        cover = np.asarray(alpha, np.float64)[..., None]
        straight = np.asarray(rgb, np.float64) / np.maximum(cover, 1e-6)
        pixels = to_bytes(np.concatenate([straight, cover], axis=-1))
    with _beside(path) as partial:
        _write_picture(partial, pixels)
    return path


def _write_picture(path: Path, pixels: Frame) -> None:
    import imageio.v3 as imageio

    # From memory, since the writer complains once more, too late, where the disk is full.
    made = imageio.imwrite("<bytes>", pixels, extension=path.suffix.lower())
    assert made is not None
    path.write_bytes(made)


def write_video(
    path: str | Path,
    frames: Iterable[ArrayLike],
    fps: float = 30.0,
    *,
    on_frame: Callable[[int, float], None] | None = None,
) -> Path:
    """Write frames to an .mp4 (.mov, .mkv, .webm), a .gif, or a folder of PNGs.

    frames: (height, width, 3) pictures of one size, uint8 or floats in 0 to 1, made while
    earlier ones are encoded. A path without extension is a folder, its files named
    ``frame_0000.png`` and on; only there may frames have a fourth channel, straight alpha.
    Videos with an odd side get their last row or column twice, since h264 halves the colours.
    Without ffmpeg at hand a video becomes a .gif of the same stem.

    on_frame: called after each frame with how many are made and how many were made a second.

    Returns the path written to. Raises OutputError where there is no frame, sizes differ, the
    extension is unknown or the place can't be written; whatever ``frames`` raises comes
    through. Nothing is left behind then.
    """
    path = Path(path)
    if path.suffix.lower() in VIDEOS and not _has_ffmpeg():
        path = path.with_suffix(".gif")
    with _beside(path) as partial, _sink(partial, fps) as sink, _on_thread(sink) as send:
        shape = None
        started = time.perf_counter()
        channels = ((3,), (4,)) if path.suffix == "" else ((3,),)
        for count, frame in enumerate(frames, 1):
            pixels = to_bytes(frame)
            shape = shape or pixels.shape
            if pixels.shape != shape or shape[2:] not in channels:
                raise OutputError(
                    f"{path}: a frame has shape {pixels.shape}, expected {shape[:2]} pixels of "
                    f"{' or '.join(str(count) for (count,) in channels)} channels"
                )
            send(pixels)
            if on_frame is not None:
                on_frame(count, count / max(time.perf_counter() - started, 1e-9))
        if shape is None:
            raise OutputError(f"{path}: there are no frames to write")
    return path


@contextlib.contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """A temporary neighbour that takes the place of ``path`` when all went well."""
    check_output(path)
    try:
        with beside(path) as partial:
            yield partial
            if partial.is_dir() and path.is_dir():
                _remove_frames(path)
    except OSError as error:
        raise OutputError(f"{path}: can't be written: {error.strerror or error}") from error


def check_output(path: str | Path) -> None:
    """Refuse a path that no picture or frames can be written to, before any are made.

    Raises OutputError: an extension that is none of ours, or a folder that isn't there.
    """
    path = Path(path)
    known = (*PICTURES, *VIDEOS, ".gif", "")
    if path.suffix.lower() not in known:
        raise OutputError(f"{path}: expected {', '.join(known[:-1])} or a folder")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: its folder does not exist: make it first")


def _remove_frames(folder: Path) -> None:
    """Remove a folder of earlier frames, and refuse if it holds anything else."""
    if strangers := [file.name for file in folder.iterdir() if not FRAME.fullmatch(file.name)]:
        raise OutputError(
            f"{folder}: holds {strangers[0]!r}, expected only frames; choose another folder"
        )
    shutil.rmtree(folder)


@contextlib.contextmanager
def _on_thread(sink: Sink) -> Iterator[Sink]:
    """A sink that hands frames to ``sink`` on a thread; its failures are raised here."""
    waiting: queue.Queue[Frame | None] = queue.Queue(QUEUE)
    failures: list[BaseException] = []

    def work() -> None:
        while (frame := waiting.get()) is not None:
            if not failures:
                try:
                    sink(frame)
                except BaseException as error:
                    failures.append(error)

    def send(frame: Frame) -> None:
        if failures:
            raise failures[0]
        waiting.put(frame)

    thread = threading.Thread(target=work, name="encoder", daemon=True)
    thread.start()
    try:
        yield send
    finally:
        waiting.put(None)
        thread.join()
    if failures:
        raise failures[0]


@contextlib.contextmanager
def _sink(path: Path, fps: float) -> Iterator[Sink]:
    suffix = path.suffix.lower()
    if suffix in VIDEOS:
        with _ffmpeg(path, fps) as sink:
            yield sink
    elif suffix == ".gif":
        with _gif(path, fps) as sink:
            yield sink
    elif suffix == "":
        yield _folder(path)
    else:
        raise OutputError(f"{path.name}: expected .mp4, .gif or a folder, not {suffix!r}")


def _has_ffmpeg() -> bool:
    try:
        import imageio_ffmpeg

        return bool(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        return False


class _Encoder:
    """ffmpeg, fed with frames; the file is read back before it counts as written."""

    def __init__(self, path: Path, fps: float) -> None:
        self.path, self.fps = path, fps
        self.process: subprocess.Popen[bytes] | None = None
        self.said = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the encoder
        self.count = 0

    def send(self, frame: Frame) -> None:
        height, width = frame.shape[:2]
        if height % 2 or width % 2:
            frame = np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        if self.process is None:
            self.process = self._start(frame.shape[1], frame.shape[0])
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(np.ascontiguousarray(frame).data)
        except BrokenPipeError:
            self.process.wait()
            raise OutputError(f"{self.path.name}: {self._complaint()}") from None
        self.count += 1

    def _start(self, width: int, height: int) -> subprocess.Popen[bytes]:
        from imageio_ffmpeg import get_ffmpeg_exe

        codec = VP9 if self.path.suffix.lower() == ".webm" else H264
        command = [get_ffmpeg_exe(), "-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
        command += ["-s", f"{width}x{height}", "-r", f"{self.fps:.6g}", "-i", "-", "-an", *codec]
        # As a file: a colon in its name would make it a protocol. In a session of its own, so
        # that Ctrl-C is ours to handle.
        return subprocess.Popen(
            [*command, f"file:{self.path}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=self.said,
            start_new_session=True,
        )

    def finish(self) -> None:
        """Close the file and make sure that it plays."""
        from imageio_ffmpeg import count_frames_and_secs

        if self.process is None:
            return
        self.close()
        if self.process.returncode:
            raise OutputError(f"{self.path.name}: {self._complaint()}")
        try:
            found, _ = count_frames_and_secs(str(self.path))
        except RuntimeError:
            found = 0
        if found != self.count:
            raise OutputError(
                f"{self.path.name}: holds {found} of {self.count} frames after encoding; is there "
                "room on the disk?"
            )

    def close(self) -> None:
        """End ffmpeg, whatever it has written."""
        if self.process is not None and self.process.stdin is not None:
            with contextlib.suppress(OSError):
                self.process.stdin.close()
            self.process.wait()

    def _complaint(self) -> str:
        self.said.seek(0)
        lines = self.said.read().decode(errors="replace").split("\n")
        full = next((line for line in lines if "No space left" in line), None)
        if full:
            return "can't be written: the disk is full; free some space first"
        return f"ffmpeg failed: {next(filter(None, lines), 'it said nothing')}"


@contextlib.contextmanager
def _ffmpeg(path: Path, fps: float) -> Iterator[Sink]:
    encoder = _Encoder(path, fps)
    try:
        yield encoder.send
        encoder.finish()
    finally:
        encoder.close()
        encoder.said.close()


@contextlib.contextmanager
def _gif(path: Path, fps: float) -> Iterator[Sink]:
    import imageio.v2 as imageio

    # A gif counts hundredths of a second, and players slow down what is below two of them.
    duration = max(20, round(100 / fps) * 10)
    writer: Any
    # In memory, as a picture is.
    made = io.BytesIO()
    with imageio.get_writer(made, format="GIF", duration=duration, loop=0) as writer:
        yield writer.append_data
    path.write_bytes(made.getvalue())


def _folder(path: Path) -> Sink:
    path.mkdir()
    count = 0

    def send(frame: Frame) -> None:
        nonlocal count
        _write_picture(path / f"frame_{count:04d}.png", frame)
        count += 1

    return send
