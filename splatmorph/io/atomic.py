"""Write beside, then rename: an output is whole or it is not there."""

from __future__ import annotations

import contextlib
import errno
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from renderer.beside import beside
from splatmorph.errors import WriteError


@contextlib.contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """A path beside ``path`` to write to; it takes the place of ``path`` when the block ends well.

    The temporary name keeps the extension, since writers choose formats by it. Nothing is left
    when the block raises; a file that was at ``path`` before stays as it was.

    Raises:
        WriteError: the folder is missing or unwritable, the disk is full, the rename failed.
    """
    path = Path(path)
    if path.is_dir():
        raise WriteError(f"{path} is a directory, expected a file name to write to")
    try:
        with beside(path) as partial:
            yield partial
    except OSError as error:
        raise WriteError(f"can't write {path}: {_reason(error)}") from error


def write_json(path: str | Path, value: Mapping[str, Any]) -> None:
    """Write one JSON object to ``path``, whole or not at all.

    Raises:
        WriteError: see :func:`atomic_write`.
    """
    with atomic_write(path) as partial:
        partial.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def make_folder(path: str | Path) -> Path:
    """Make the folder ``path`` with its parents, if it isn't there.

    Raises:
        WriteError: it can't be made, or a file stands in its place.
    """
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError(f"can't make the folder {path}: {_reason(error)}") from error
    return path


def _reason(error: OSError) -> str:
    if error.errno == errno.ENOSPC:
        return "the disk is full; free some space or choose another place (`out`)"
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return "no permission to write there; choose another place (`out`)"
    if error.errno == errno.ENOENT:
        return "its folder does not exist"
    return str(error.strerror or error)
