"""``splatmorph batch``: Fit many pairs that a table names, each into a run of its own."""

from __future__ import annotations

import csv
import dataclasses
import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.fit import FittingOptions, PosingOptions
from splatmorph.app.options import Auto, Device, Json, Out, Overwrite, choose_device
from splatmorph.errors import FitError, OutputExistsError, ReadError, RunError, SplatmorphError
from splatmorph.runs.settings import DEFAULT_FITTING, DEFAULT_POSING, Finding, Fitting, Posing

if TYPE_CHECKING:
    from splatmorph.runs import Request

LANDMARKS = ("source_landmarks", "target_landmarks")
PATHS = ("source", "target", *LANDMARKS)
NAME = "name"
SUMMARY = "summary.csv"


@dataclass(frozen=True)
class Row:
    """A pair of the table."""

    name: str
    """Of its run."""
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
    """fitted; kept, if it was there already; missed, if many landmarks are; or failed."""
    landmarks: int | None = None
    rms_error: float | None = None
    """Root mean square distance of the landmarks."""
    worst_error: float | None = None
    """Of one landmark, at its worst t."""
    worst_landmark: str | None = None
    det_min: float | None = None
    seconds: float | None = None
    message: str = ""
    """Why it failed, or what is missed."""

    @staticmethod
    def of(name: str, status: str, report: Mapping[str, Any]) -> Result:
        """The result that a fit's report says."""
        worst, error = next(iter(report["errors"].items()))
        missed = report["missed"]
        return Result(
            name,
            "missed" if missed else status,
            message=report["status"] if missed else "",
            landmarks=report["landmarks"],
            rms_error=(3 * report["mse_world"]) ** 0.5,
            worst_error=error,
            worst_landmark=worst,
            det_min=report["det_min"],
            seconds=report["seconds"],
        )


def batch(
    pairs: Annotated[
        Path,
        Parameter(
            help="A CSV file with the columns source and target, and if need be source_landmarks, "
            "target_landmarks and name; its paths start from its folder."
        ),
    ],
    /,
    *,
    out: Out = None,
    fitting: FittingOptions = DEFAULT_FITTING,
    posing: PosingOptions = DEFAULT_POSING,
    auto: Auto = True,
    device: Device = "cpu",
    overwrite: Overwrite = False,
    json: Json = False,
) -> int:
    """Fit every pair of a table into a folder of runs, and sum them up in summary.csv.

    A pair that is wrong doesn't stop the others. The same command again goes on where it was
    stopped: runs of the same inputs and options are kept; those of others need -w. Exits with 3
    where none failed but many landmarks of a pair are missed by far.
    """
    from splatmorph.io.atomic import make_folder

    rows, finding = read_rows(pairs), Finding(auto)
    folder = make_folder(out or Path(f"{pairs.stem}-runs"))
    results: list[Result] = []
    try:
        for number, row in enumerate(rows, 1):
            console.note(f"{number}/{len(rows)} {row.name}")
            run = folder / f"{row.name}.run"
            try:
                results.append(_fit_row(row, run, fitting, posing, finding, device, overwrite))
            except SplatmorphError as error:
                console.fail(f"{row.name}: {error}")
                results.append(Result(row.name, "failed", message=console.spoken(error)))
    finally:
        _write_summary(folder / SUMMARY, results)
    if json:
        console.emit_json({"pairs": [dataclasses.asdict(result) for result in results]})
    else:
        console.say(_table(results))
        console.say("")
        console.say(f"wrote {folder / SUMMARY}")
    failed = [result.name for result in results if result.status == "failed"]
    if failed:
        raise FitError(
            f"{len(failed)} of {len(rows)} pairs failed ({', '.join(failed[:5])}"
            f"{', …' if len(failed) > 5 else ''}), {folder / SUMMARY} says why: mend them and give "
            "the same command again"
        )
    missed = [result.name for result in results if result.status == "missed"]
    for name in missed:
        console.warn(f"{name} misses many of its landmarks by far; {folder / SUMMARY} says which")
    return console.MISSED if missed else 0


def read_rows(path: Path) -> list[Row]:
    """The pairs of a table, in its order.

    Raises:
        ReadError: no table, columns or cells that are missing or unknown, or two runs of one name.
    """
    from splatmorph.io.reading import read_text, reading

    text = read_text(path)
    with reading(path, "CSV file", remedy="save it as CSV in UTF-8"):
        reader = csv.DictReader(io.StringIO(text, newline=""), skipinitialspace=True)
        columns = reader.fieldnames = [column.strip() for column in reader.fieldnames or ()]
        lines = [(reader.line_num, cells) for cells in reader]
    known = (*PATHS, NAME)
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
    from splatmorph.io import stem_of

    if None in cells:
        raise ReadError(f"{path} has more cells than columns in line {line}: mend it")
    given = {column: (cells.get(column) or "").strip() for column in (*PATHS, NAME)}
    if not (given["source"] and given["target"]):
        raise ReadError(f"{path} names no source or no target in line {line}: mend it")
    name = given[NAME] or "-".join(stem_of(given[end]) for end in ("source", "target"))
    if Path(name).name != name or name.startswith("."):
        raise ReadError(f"{path} names the run '{name}' in line {line}, expected a file's name")
    source, target = (path.parent / given[end] for end in ("source", "target"))
    marks = (path.parent / given[side] if given[side] else None for side in LANDMARKS)
    return Row(name, line, source, target, *marks)


def _fit_row(
    row: Row,
    run: Path,
    fitting: Fitting,
    posing: Posing,
    finding: Finding,
    device: str,
    overwrite: bool,
) -> Result:
    from splatmorph.runs.request import Request
    from splatmorph.runs.run import MANIFEST
    from splatmorph.runs.state import has_state

    own = {side: getattr(row, side) or getattr(posing, side) for side in LANDMARKS}
    asked = Request.of(
        (row.source, row.target),
        fitting,
        dataclasses.replace(posing, **own),
        finding,
        on_warning=console.warn,
    )
    if (run / MANIFEST).is_file() and not has_state(run):
        report = _report_of_same(asked, run)
        if report is not None and not report["interrupted"]:
            return Result.of(row.name, "kept", report)
        if report is None and not overwrite:
            raise OutputExistsError(
                f"{run} is a run of other inputs or options: give -w to fit it anew, or another "
                "name"
            )
        overwrite = True
    with console.fitting() as on_step:
        fitted = asked.fit(
            run,
            device=choose_device(device),
            resume=has_state(run) and not overwrite,
            overwrite=overwrite,
            on_step=on_step,
            on_warning=console.warn,
        )
    report = fitted.legs[0].report
    if report["interrupted"]:
        raise KeyboardInterrupt
    return Result.of(row.name, "fitted", report)


def _report_of_same(asked: Request, run: Path) -> Mapping[str, Any] | None:
    """The report of ``run``, if it is of what is asked and whole."""
    from splatmorph.runs import open_run

    try:
        found = open_run(run)
    except RunError:
        return None
    return found.legs[0].report if asked.made(found) else None


def _write_summary(path: Path, results: Sequence[Result]) -> None:
    from splatmorph.io.atomic import atomic_write

    columns = [field.name for field in dataclasses.fields(Result)]
    with atomic_write(path) as partial, partial.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(dataclasses.astuple(result) for result in results)


def _table(results: Sequence[Result]) -> Any:
    made = console.table("pair", "", "landmarks", "rms error", "worst error", "min det", "time")
    # A name is needed in full, to type it.
    made.columns[0].overflow = "fold"
    for one in results:
        if one.status == "failed":
            made.add_row(one.name, one.status)
            continue
        made.add_row(
            one.name,
            one.status,
            str(one.landmarks),
            f"{one.rms_error:.3g}",
            f"{one.worst_error:.3g}",
            f"{one.det_min:.3g}",
            f"{one.seconds:.1f} s",
        )
    return made
