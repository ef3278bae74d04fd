"""``splatmorph batch``: Fit many pairs that a table names, each into a run of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.fit import FittingOptions, PosingOptions
from splatmorph.app.options import Auto, Device, Json, Out, Overwrite, choose_device
from splatmorph.errors import FitError, SplatmorphError
from splatmorph.runs.settings import DEFAULT_FITTING, DEFAULT_POSING, Finding

if TYPE_CHECKING:
    from splatmorph.runs.batch import Result

SUMMARY = "summary.csv"


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
    from splatmorph.runs.batch import Result, fit_row, read_rows, write_summary

    rows, finding = read_rows(pairs), Finding(auto)
    folder = make_folder(out or Path(f"{pairs.stem}-runs"))
    results: list[Result] = []
    try:
        for number, row in enumerate(rows, 1):
            console.note(f"{number}/{len(rows)} {row.name}")
            try:
                with console.fitting() as on_step:
                    result = fit_row(
                        row,
                        folder / f"{row.name}.run",
                        fitting,
                        posing,
                        finding,
                        device=choose_device(device),
                        overwrite=overwrite,
                        on_step=on_step,
                        on_warning=console.warn,
                    )
                results.append(result)
            except SplatmorphError as error:
                console.fail(f"{row.name}: {error}")
                results.append(Result(row.name, "failed", message=console.spoken(error)))
    finally:
        write_summary(folder / SUMMARY, results)
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
