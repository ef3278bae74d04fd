"""What every reader does alike: whatever is wrong with a file becomes one line that names it."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from splatmorph.errors import ReadError, SplatmorphError

LARGEST_TEXT = 16 << 20
"""Bytes of a text file; Python's objects take some thirty times as many."""
LONGEST_REASON = 160


@contextlib.contextmanager
def reading(
    path: str | Path, what: str, *, error: type[SplatmorphError] = ReadError, remedy: str = ""
) -> Iterator[None]:
    """Read ``path`` inside: every lower error becomes an ``error`` of one line.

    Libraries raise whatever a damaged file makes them, so that no list of errors is whole.

    Args:
        path: named by the line.
        what: the file should be, such as ``landmark file``.
        error: what is raised.
        remedy: what to do about it, where there is more to say than to get the file again.

    Raises:
        SplatmorphError: as ``error``; those raised inside come through as they are.
    """
    try:
        yield
    except SplatmorphError:
        raise
    except OSError as lower:
        raise error(f"can't read {path}: {lower.strerror or reason(lower)}") from lower
    except MemoryError as lower:
        raise error(f"{path} takes more memory to read than there is") from lower
    except Exception as lower:
        ending = f"; {remedy}" if remedy else ""
        raise error(f"{path} is no whole {what}: {reason(lower)}{ending}") from lower


def reason(error: BaseException) -> str:
    """What an error says first, cut where that is long."""
    text = str(error)
    if isinstance(error, KeyError):
        text = f"it has no {text}"
    if isinstance(error, RecursionError):
        text = "it nests too deep"
    first = next(iter(text.splitlines()), "") or f"it makes no sense ({type(error).__name__})"
    return first if len(first) <= LONGEST_REASON else f"{first[:LONGEST_REASON]}…"


def read_text(path: Path) -> str:
    """A text file in UTF-8, a byte order mark at its head left out.

    Raises:
        ReadError: it is missing, too large, or no text.
    """
    require_file(path)
    with reading(path, "text file"):
        size = path.stat().st_size
        if size > LARGEST_TEXT:
            raise ReadError(
                f"{path} has {size >> 20} MB, expected a text file of at most {LARGEST_TEXT >> 20}"
            )
        raw = path.read_bytes()
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ReadError(
            f"{path} is no text: byte {error.start} is no UTF-8; save it as UTF-8"
        ) from error


def read_json(
    path: Path,
    what: str = "JSON file",
    *,
    pairs: Callable[[list[tuple[str, Any]]], Any] | None = None,
) -> Any:
    """What a JSON file holds; ``pairs`` makes something else than dicts of its objects.

    Raises:
        ReadError: it is missing, too large, or no JSON.
    """
    text = read_text(path)
    with reading(path, what):
        return json.loads(text, object_pairs_hook=pairs)


def require_file(path: str | Path) -> None:
    """Refuse what can't be read to an end: folders, devices and pipes.

    Raises:
        ReadError: it is missing, or no file.
    """
    path = Path(path)
    with reading(path, "file"):
        if not path.is_file():
            path.stat()
            kind = "a directory" if path.is_dir() else "a device or a pipe"
            raise ReadError(f"{path} is {kind}, expected a file")
