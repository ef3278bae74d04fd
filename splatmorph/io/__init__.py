"""Splat files in and out: a module a format, found by the file's extension."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from splatmorph.errors import OptionError, ReadError
from splatmorph.gaussians import Gaussians
from splatmorph.io.ply import read_ply, write_ply

READERS: dict[str, Callable[[Path], Gaussians]] = {".ply": read_ply}
WRITERS: dict[str, Callable[[Path, Gaussians, Sequence[str]], None]] = {".ply": write_ply}


def read(path: str | Path) -> Gaussians:
    """Read a splat in world space.

    Args:
        path: a file whose extension names the format.

    Raises:
        LocalFrameError: the file holds a triangle-local avatar.
        ReadError: the file is missing, of another format, damaged, or holds values that no
            renderer can show.
    """
    path = Path(path)
    if path.is_dir():
        raise ReadError(f"{path} is a directory, expected a splat file ({_known(READERS)})")
    if path.suffix.lower() not in READERS:
        raise ReadError(f"{path} has an extension we don't read; we read {_known(READERS)}")
    return READERS[path.suffix.lower()](path)


def write(path: str | Path, gaussians: Gaussians, comments: Sequence[str] = ()) -> None:
    """Write a splat, whole or not at all.

    Args:
        path: the extension names the format.
        gaussians: what to write.
        comments: lines for the file's header, where the format has room for them.

    Raises:
        OptionError: no writer for this extension.
        WriteError: the file can't be written; one that was there before is untouched.
    """
    path = Path(path)
    if path.suffix.lower() not in WRITERS:
        raise OptionError(f"{path} has an extension we don't write; we write {_known(WRITERS)}")
    WRITERS[path.suffix.lower()](path, gaussians, comments)


def _known(registry: Mapping[str, object]) -> str:
    return ", ".join(sorted(registry))


__all__ = ["READERS", "WRITERS", "read", "write"]
