"""Many pairs that a table names: what each is, and what becomes of it."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import io
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from splatmorph.errors import OutputExistsError, ReadError, RunError, WriteError
from splatmorph.io import stem_of
from splatmorph.io.atomic import make_folder, write_json
from splatmorph.io.reading import read_json, read_text, reading
from splatmorph.runs.request import OnStep, OnWarning, Request, made_by_search
from splatmorph.runs.run import MANIFEST, Run, open_run
from splatmorph.runs.settings import Finding, Fitting, Posing
from splatmorph.runs.state import has_state

LANDMARKS = ("source_landmarks", "target_landmarks")
PATHS = ("source", "target", *LANDMARKS)
NAME, KIND = "name", "kind"
SPLATS, PICTURES = "splats", "pictures"
ROWS = ".rows"
"""The folder, in that of a batch, of what each row has done, and of the locks."""
BEGUN, DONE = "begun", "done"


@dataclass(frozen=True)
class Row:
    """A pair of the table."""

    name: str
    """Of its run, and of what is made of it."""
    kind: str
    """splats or pictures."""
    line: int
    source: Path
    target: Path
    source_landmarks: Path | None
    target_landmarks: Path | None


@dataclass(frozen=True)
class Result:
    """What became of a pair; in world units."""

    name: str
    status: str
    """fitted; kept, if that was there already; missed, if many landmarks are; or failed."""
    landmarks: int | None = None
    rms_error: float | None = None
    """Root mean square distance of the landmarks."""
    worst_error: float | None = None
    """Of one landmark, at its worst t."""
    worst_landmark: str | None = None
    mse: float | None = None
    """Of the landmarks, a coordinate: the paper's metric, in world units²."""
    det_min: float | None = None
    """Least determinant; of pictures, of the warps over the whole picture."""
    folded: float | None = None
    """Share of a picture that is turned over."""
    seconds: float | None = None
    """Of the fit."""
    message: str = ""
    """Why it failed, or what is missed."""
    files: tuple[str, ...] = ()
    """What was made, in the folder of the batch."""

    @staticmethod
    def of(name: str, status: str, report: Mapping[str, Any], dim: int = 3) -> Result:
        """The result that a fit's report says."""
        worst, error = next(iter(report["errors"].items()))
        missed = report["missed"]
        return Result(
            name,
            "missed" if missed else status,
            message=report["status"] if missed else "",
            landmarks=report["landmarks"],
            rms_error=(dim * report["mse_world"]) ** 0.5,
            worst_error=error,
            worst_landmark=worst,
            mse=report["mse_world"],
            det_min=report["det_min"],
            seconds=report["seconds"],
        )


def read_rows(path: Path) -> list[Row]:
    """The pairs of a table, in its order.

    Raises:
        ReadError: no table, columns or cells that are missing or unknown, or two runs of one name.
    """
    text = read_text(path)
    with reading(path, "CSV file", remedy="save it as CSV in UTF-8"):
        reader = csv.DictReader(io.StringIO(text, newline=""), skipinitialspace=True)
        columns = reader.fieldnames = [column.strip() for column in reader.fieldnames or ()]
        lines = [(reader.line_num, cells) for cells in reader]
    known = (*PATHS, NAME, KIND)
    repeated = len(set(columns)) < len(columns)
    if repeated or not {"source", "target"} <= set(columns) <= set(known):
        raise ReadError(
            f"{path} begins with {','.join(columns) or 'nothing'}, expected the columns "
            f"source,target and those needed of {','.join(known[2:])}, with commas between"
        )
    rows = [_row(path, line, cells) for line, cells in lines]
    if not rows:
        raise ReadError(f"{path} holds no pairs, expected at least one line after the first")
    name, count = Counter(row.name for row in rows).most_common(1)[0]
    if count > 1:
        where = " and ".join(str(row.line) for row in rows if row.name == name)
        raise ReadError(
            f"{path} makes the run {name} in lines {where}: tell them apart in a column {NAME}"
        )
    return rows


def _row(path: Path, line: int, cells: Mapping[str | None, Any]) -> Row:
    if None in cells:
        raise ReadError(f"{path} has more cells than columns in line {line}: mend it")
    given = {column: (cells.get(column) or "").strip() for column in (*PATHS, NAME, KIND)}
    if not (given["source"] and given["target"]):
        raise ReadError(f"{path} names no source or no target in line {line}: mend it")
    name = given[NAME] or "-".join(stem_of(given[end]) for end in ("source", "target"))
    if Path(name).name != name or name.startswith("."):
        raise ReadError(f"{path} names the run '{name}' in line {line}, expected a file's name")
    kind = given[KIND] or SPLATS
    if kind not in (SPLATS, PICTURES):
        raise ReadError(
            f"{path} says the kind '{kind}' in line {line}, expected {SPLATS} or {PICTURES}"
        )
    folder = path.absolute().parent
    source, target = (folder / given[end] for end in ("source", "target"))
    marks = (folder / given[side] if given[side] else None for side in LANDMARKS)
    return Row(name, kind, line, source, target, *marks)


def fit_row(
    row: Row,
    out: Path,
    fitting: Fitting,
    posing: Posing,
    finding: Finding,
    *,
    device: str = "cpu",
    overwrite: bool = False,
    on_step: OnStep | None = None,
    on_warning: OnWarning | None = None,
) -> Result:
    """Fit a pair into the run ``out``, go on with it, or keep it where it is what is asked.

    Raises:
        OutputExistsError: ``out`` is of other inputs or options, and may not be overwritten.
        KeyboardInterrupt: the fit was interrupted; what it has is kept.
        SplatmorphError: whatever is wrong with the pair.
    """
    own = {side: getattr(row, side) or getattr(posing, side) for side in LANDMARKS}
    ends, posing = (row.source, row.target), dataclasses.replace(posing, **own)
    finished = (out / MANIFEST).is_file() and not has_state(out)
    if finished:
        report = _report_of(out, lambda run: made_by_search(run, ends, fitting, posing, finding))
        if report is not None and not report["interrupted"]:
            return Result.of(row.name, "kept", report)
    asked = Request.of(ends, fitting, posing, finding, on_warning=on_warning)
    if finished:
        report = _report_of(out, asked.made)
        if report is not None and not report["interrupted"]:
            return Result.of(row.name, "kept", report)
        if report is None and not overwrite:
            raise OutputExistsError(
                f"{out} is a run of other inputs or options: give `overwrite` to fit it anew, or "
                "another name"
            )
        overwrite = True
    fitted = asked.fit(
        out,
        device=device,
        resume=not overwrite,  # a kill may leave no more than a part of a run
        overwrite=overwrite,
        on_step=on_step,
        on_warning=on_warning,
    )
    report = fitted.legs[0].report
    if report["interrupted"]:
        raise KeyboardInterrupt
    return Result.of(row.name, "fitted", report)


def _report_of(run: Path, is_it: Callable[[Run], bool]) -> Mapping[str, Any] | None:
    """The report of ``run``, if it is whole and what is asked for."""
    try:
        found = open_run(run)
    except RunError:
        return None
    return found.legs[0].report if is_it(found) else None


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """A folder of runs that no other batch works in meanwhile.

    Raises:
        RunError: another one does.
        WriteError: no lock can be made there.
    """
    rows = make_folder(folder / ROWS)
    lock = FileLock(rows / "batch.lock", timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise RunError(
            f"another batch is at work in {folder}: wait for it, or give another `out`"
        ) from error
    except (OSError, NotImplementedError) as error:
        raise WriteError(f"can't lock {folder}: {error}") from error
    try:
        yield
    finally:
        lock.release()


@dataclass(frozen=True)
class Record:
    """What a row has done, kept beside the runs: so that the same command does it only once."""

    path: Path

    @staticmethod
    @contextlib.contextmanager
    def of(folder: Path, name: str) -> Iterator[Record]:
        """That of a row, which only one process has at a time.

        A worker may still be busy with a row when its batch has gone: it is waited for.
        """
        rows = make_folder(folder / ROWS)
        with FileLock(rows / f"{name}.lock"):
            yield Record(rows / f"{name}.json")

    def has(self, step: str, asked: str, made: Path, overwrite: bool) -> bool:
        """Whether ``made`` is what the step makes of what is ``asked``.

        Raises:
            OutputExistsError: it is something else, and may not be overwritten.
        """
        kept = self._steps().get(step)
        if not made.exists() or kept == [asked, BEGUN]:
            return False
        if kept == [asked, DONE]:
            return True
        if not overwrite:
            raise OutputExistsError(
                f"{made} is of other inputs or options: give `overwrite` to make it anew, or "
                "another name"
            )
        return False

    def begin(self, step: str, asked: str) -> None:
        """Note that what the step makes is now ours to replace."""
        self._note(step, asked, BEGUN)

    def end(self, step: str, asked: str) -> None:
        """Note that the step is done."""
        self._note(step, asked, DONE)

    def _note(self, step: str, asked: str, state: str) -> None:
        write_json(self.path, self._steps() | {step: [asked, state]})

    def _steps(self) -> dict[str, Any]:
        # Unreadable, it says nothing: then nothing is taken for ours.
        with contextlib.suppress(ReadError):
            found = read_json(self.path)
            return found if isinstance(found, dict) else {}
        return {}
