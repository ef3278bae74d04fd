"""Write beside, then rename: an output is whole or it is not there."""

from __future__ import annotations

import contextlib
import os
import platform
import re
import shutil
import zlib
from collections.abc import Iterator
from pathlib import Path

MARK = ".partial-"
_HOST = f"{zlib.crc32(platform.node().encode()):08x}"
_NAME = re.compile(re.escape(MARK) + rf"(\d+)-{_HOST}-")
_cleaned: set[Path] = set()


@contextlib.contextmanager
def beside(path: Path) -> Iterator[Path]:
    """A hidden neighbour to write to, file or folder; it takes ``path``'s place if all goes well.

    Its name keeps the extension, since writers choose formats by it, and says whose it is.
    Nothing is left when the block raises; what was at ``path`` before stays as it was. What
    killed processes left in the folder is removed.

    Raises ``OSError``.
    """
    folder = path.parent.absolute()
    if folder not in _cleaned:
        _cleaned.add(folder)
        remove_strays(folder)
    partial = path.with_name(f"{MARK}{os.getpid()}-{_HOST}-{path.name}")
    try:
        yield partial
        partial.replace(path)
    finally:
        _remove(partial)


def remove_strays(folder: Path) -> None:
    """Remove what processes of this machine left half-written in ``folder``, if they are gone."""
    with contextlib.suppress(OSError):
        for stray in [*folder.iterdir()]:
            found = _NAME.match(stray.name)
            if found and not _lives(int(found[1])):
                _remove(stray)


def _lives(process: int) -> bool:
    if os.name != "posix":
        return True  # elsewhere the question would end it
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return True


def _remove(place: Path) -> None:
    if place.is_dir():
        shutil.rmtree(place, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            place.unlink(missing_ok=True)
