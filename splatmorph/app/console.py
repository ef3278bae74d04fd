"""What the terminal sees: results on stdout, progress and warnings on stderr."""

from __future__ import annotations

import codecs
import contextlib
import io
import json
import logging
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from splatmorph.errors import OutputExistsError, WriteError

if TYPE_CHECKING:
    from splatmorph.avatars import Drive
    from splatmorph.fitting import FitProgress
    from splatmorph.morph import Chain, Morph

INTERRUPTED = 130
MISSED = 3
"""Exit code of a command whose morph doesn't meet what was asked."""

# No emoji: file names are printed as they are.
out = Console(highlight=False, soft_wrap=True, emoji=False)
err = Console(stderr=True, highlight=False, soft_wrap=True, emoji=False)

SHORT = {"out": "-o", "overwrite": "-w"}
"""Options that people know by one letter."""


PLAIN = {"→": "->", "×": "x", "Φ": "Phi", "∂": "d", "²": "^2", "°": " deg", "±": "+-", "…": "..."}
"""ASCII for what some terminals can't show."""


def speak_plainly() -> None:
    """Let no letter that the terminal lacks end a command whose work is done."""

    def plain(error: UnicodeError) -> tuple[str, int]:
        if not isinstance(error, UnicodeEncodeError):
            raise error
        lacking = error.object[error.start : error.end]
        return "".join(PLAIN.get(letter, "?") for letter in lacking), error.end

    codecs.register_error("plain", plain)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="plain")


@dataclass
class Manner:
    """How much the terminal wants to hear, set once from the global options."""

    quiet: bool = False
    """No progress, no summaries: only what failed."""
    verbose: bool = False
    """Tracebacks with the errors."""


manner = Manner()


def say(*parts: object) -> None:
    """Print a result, each text a line, unless ``--quiet``. No markup is seen in file names."""
    if not manner.quiet:
        shown = (one_line(part) if isinstance(part, str) else part for part in parts)
        out.print(*shown, markup=False)


def note(message: str) -> None:
    """Print a line of progress to stderr, unless ``--quiet``."""
    if not manner.quiet:
        err.print(one_line(message), markup=False)


def warn(message: str) -> None:
    """Print a warning to stderr, unless ``--quiet``."""
    if not manner.quiet:
        err.print(f"warning: {one_line(spoken(message))}", style="yellow", markup=False)


def fail(message: str) -> None:
    """Print the one line of an error to stderr, whatever the manner."""
    err.print(f"error: {one_line(spoken(message))}", style="red", markup=False)


def one_line(text: str) -> str:
    """``text`` without what a file name may hold to break the line or to steer the terminal."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


def spoken(message: object) -> str:
    """What the library says, with its parameters spelled as options: `overwrite` as -w.

    The library names them in backticks and knows no option.
    """
    return re.sub(
        r"`([a-z_]+)`",
        lambda found: SHORT.get(found[1], "--" + found[1].replace("_", "-")),
        str(message),
    )


class _Listener(logging.Handler):
    """The library's log, shown as our own lines."""

    def emit(self, record: logging.LogRecord) -> None:
        (note if record.name == "renderer.notices" else warn)(record.getMessage())


def listen() -> None:
    """Show what the renderer and the library log."""
    for log in (logging.getLogger("renderer"), logging.getLogger("splatmorph")):
        if not any(isinstance(handler, _Listener) for handler in log.handlers):
            log.addHandler(_Listener())
            log.setLevel(logging.INFO)
            log.propagate = False


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Print nothing at all: where a command is called for its output only."""
    before = out.quiet, err.quiet
    out.quiet = err.quiet = True
    try:
        yield
    finally:
        out.quiet, err.quiet = before


def emit_json(value: Mapping[str, object]) -> None:
    """Print one JSON document for a machine to read, whatever the manner."""
    out.print_json(json.dumps(value, allow_nan=False, default=str), indent=2, highlight=False)


class _Lines(Table):
    """A table whose rows are a line each."""

    def add_row(self, *cells: Any, **options: Any) -> None:
        super().add_row(*map(one_line, cells), **options)


def table(*columns: str, title: str | None = None) -> Table:
    """A plain table: the first column text, the others numbers."""
    made = _Lines(title=title, box=None, pad_edge=False, title_justify="left")
    for i, column in enumerate(columns):
        made.add_column(column, justify="left" if i == 0 else "right")
    return made


@contextlib.contextmanager
def progress(what: str) -> Iterator[Callable[[int, int, str], None]]:
    """A bar on stderr; call what it yields with (steps done, steps in all, a short note)."""
    columns = [
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
    ]
    # Where no one watches, a bar would only leave blank lines in a log.
    hidden = manner.quiet or not err.is_terminal
    with Progress(*columns, console=err, transient=True, disable=hidden) as bar:
        task = bar.add_task(what, total=None, note="")

        def update(done: int, total: int, note: str = "") -> None:
            bar.update(task, completed=done, total=total, note=note)

        yield update


@contextlib.contextmanager
def fitting() -> Iterator[Callable[[FitProgress], None]]:
    """A bar on stderr for a fit; what it yields is the ``on_step`` of a fit."""
    with progress("fitting") as update:
        yield lambda step: update(step.step, step.steps, f"landmark MSE {step.mse:.1e}")


def prepare(morph: Morph | Chain | Drive, times: Sequence[float]) -> None:
    """Find out what frames at ``times`` need, under a bar."""
    with progress("agreeing") as update:
        morph.prepare(times, lambda done, steps: update(done, steps, ""))


def claim(path: Path, overwrite: bool) -> Path:
    """``path``, if an output may be written there.

    Raises:
        OutputExistsError: something is there and ``overwrite`` is off.
        WriteError: its folder is not there.
    """
    if not path.parent.is_dir():
        raise WriteError(f"can't write {path}: its folder does not exist, make it first")
    if path.exists() and not overwrite:
        raise OutputExistsError(
            f"{path} is already there: give -w to overwrite it, or -o to write elsewhere"
        )
    return path
