"""What becomes of a row of ``splatmorph batch``: the commands that it stands for."""

from __future__ import annotations

import dataclasses
import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from inspect import BoundArguments
from pathlib import Path
from typing import Any

from cyclopts import CycloptsError

from renderer.errors import RenderError
from splatmorph.app import app, console
from splatmorph.app.options import choose_device
from splatmorph.app.ranges import check_ranges
from splatmorph.errors import OptionError, SplatmorphError
from splatmorph.images import points
from splatmorph.io.reading import require_file
from splatmorph.runs.batch import PICTURES, Record, Result, Row, fit_row
from splatmorph.runs.inputs import fingerprint
from splatmorph.runs.request import OnStep, OnWarning
from splatmorph.runs.run import MANIFEST, WEIGHTS
from splatmorph.runs.settings import Finding, Fitting, Posing
from splatmorph.runs.summary import draw_thumbnail

ENDINGS = {"image": ".png", "render": ".mp4", "export": "-frames", "eval": "-eval.json"}
"""A command -> what follows a row's name in that of its output, unless its -o says otherwise."""
AFTER_FIT = ("render", "export", "eval")


@dataclass(frozen=True)
class Asked:
    """What is asked for of every row, in plain values: it is sent to other processes."""

    fitting: Fitting
    posing: Posing
    finding: Finding
    words: Mapping[str, str]
    """Of ``ENDINGS``, those commands that are asked for -> their options, as typed."""
    device: str
    overwrite: bool

    def __post_init__(self) -> None:
        for command, words in self.words.items():
            _parsed(command, ["a", "b"] if command == "image" else ["a"], words)


@dataclass(frozen=True)
class Task:
    """A row to be worked on, wherever that is."""

    row: Row
    folder: Path
    asked: Asked


def work(task: Task, on_step: OnStep | None = None, on_warning: OnWarning | None = None) -> Result:
    """Do what a row asks for and isn't done; what is wrong with it is in the result."""
    row = task.row
    try:
        with Record.of(task.folder, row.name) as record:
            if row.kind == PICTURES:
                return _morph_pictures(task, record)
            result = fit_row(
                row,
                run := task.folder / f"{row.name}.run",
                task.asked.fitting,
                task.asked.posing,
                task.asked.finding,
                device=choose_device(task.asked.device),
                overwrite=task.asked.overwrite,
                on_step=on_step,
                on_warning=on_warning,
            )
            files = (run, *_after_fit(task, record, run))
            return dataclasses.replace(result, files=tuple(file.name for file in files))
    except (SplatmorphError, RenderError, OSError) as error:
        return Result(row.name, "failed", message=console.spoken(error))
    except MemoryError:
        return Result(row.name, "failed", message="out of memory")


def work_silently(task: Task) -> tuple[Result, tuple[str, ...]]:
    """As ``work``, on a worker without a terminal; and what there is to warn of."""
    warnings: list[str] = []
    with console.silence():
        return work(task, on_warning=warnings.append), tuple(warnings)


def _after_fit(task: Task, record: Record, run: Path) -> list[Path]:
    of = fingerprint((run / MANIFEST, run / WEIGHTS))
    made = {
        command: _make(task, record, command, [run], of)[0]
        for command in AFTER_FIT
        if command in task.asked.words
    }
    if "render" in made:
        draw_thumbnail(task.folder, task.row.name, made["render"])
    return list(made.values())


def _morph_pictures(task: Task, record: Record) -> Result:
    row = task.row
    report = task.folder / f"{row.name}.report.json"
    given: list[str | Path] = [row.source, row.target, "--report", report]
    marks = [points.beside(one) for one in (row.source, row.target)]
    if row.source_landmarks and row.target_landmarks:
        own = row.source_landmarks, row.target_landmarks
        given += ["--source-landmarks", own[0], "--target-landmarks", own[1]]
        marks = list(own)
    elif row.source_landmarks or row.target_landmarks:
        raise OptionError("landmarks are given of one picture, expected them of both or of none")
    files = (row.source, row.target, *filter(None, marks))
    for file in files:
        require_file(file)
    of = fingerprint(files)
    picture, kept = _make(task, record, "image", given, of, report)
    draw_thumbnail(task.folder, row.name, picture)
    measured = json.loads(report.read_text(encoding="utf-8"))
    status, fitted = "kept" if kept else "fitted", measured["fit"]
    result = Result.of(row.name, status, fitted, 2) if fitted else Result(row.name, status)
    return dataclasses.replace(
        result,
        det_min=measured["area_min"],
        folded=measured["folded"],
        files=(picture.name, report.name),
    )


def _make(
    task: Task,
    record: Record,
    command: str,
    given: Sequence[str | Path],
    of: str,
    beside: Path | None = None,
) -> tuple[Path, bool]:
    """What ``command`` makes of the ``given``, whose fingerprint is ``of``; and if it was there."""
    words = task.asked.words.get(command, "")
    call, arguments = _parsed(command, given, words)
    ending = arguments.arguments.get("out") or Path(ENDINGS[command])
    path = task.folder / f"{task.row.name}{ending}"
    asked = f"{of} {words}"
    whole = path.exists() and (beside is None or beside.exists())
    if record.has(command, asked, path, task.asked.overwrite) and whole:
        return path, True
    record.begin(command, asked)
    arguments.arguments |= {"out": path, "overwrite": True}
    call(*arguments.args, **arguments.kwargs)
    record.end(command, asked)
    return path, False


def _parsed(
    command: str, given: Sequence[str | Path], words: str
) -> tuple[Callable[..., Any], BoundArguments]:
    """The command with the ``given`` and its options as they were typed.

    Raises:
        OptionError: it doesn't take them.
        RangeError: a number is out of range.
    """
    try:
        tokens = [command, *map(str, given), *shlex.split(words)]
        call, arguments, _ = app.parse_args(tokens, exit_on_error=False, print_error=False)
    except (CycloptsError, ValueError) as error:
        raise OptionError(f"--{command} takes the options of that command: {error}") from error
    check_ranges(arguments.arguments)
    ending = str(arguments.arguments.get("out", ""))
    if Path(ending).name != ending:
        raise OptionError(
            f"the -o in --{command} is {ending}, expected what follows the name of each row's "
            f"output, such as {ENDINGS[command]}"
        )
    return call, arguments
