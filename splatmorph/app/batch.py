"""``splatmorph batch``: Morph many pairs that a table names, on one process or on many."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.fit import FittingOptions, PosingOptions
from splatmorph.app.options import Auto, Device, Json, Out, Overwrite
from splatmorph.errors import FitError, OptionError
from splatmorph.runs.settings import DEFAULT_FITTING, DEFAULT_POSING, Finding

if TYPE_CHECKING:
    from splatmorph.app.rows import Task
    from splatmorph.runs.batch import Result

SUMMARY, PAGE = "summary.csv", "summary.html"


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class Steps:
    """What is made of each row: the options of that command, as one text ('' for none)."""

    render: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    """Render each run; '--t 0.5 -o .png' makes NAME.png, by default NAME.mp4."""
    export: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    """Export each run; '-o .spz --t 0.5' makes NAME.spz, by default NAME-frames."""
    eval: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    """Measure each run into NAME-eval.json."""
    image: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    """How pictures are morphed; '--warp ncf -o .mp4' makes NAME.mp4, by default NAME.png."""

    def words(self) -> dict[str, str]:
        """Those that are asked for."""
        return {name: value for name, value in vars(self).items() if value is not None}


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class Engine:
    """Where rows are worked on; by default here, one after the other."""

    workers: int | None = None
    """So many processes of this machine, which share its cores."""
    scheduler: str | None = None
    """The address of a scheduler of dask.distributed whose workers do it, tcp://HOST:8786.
    They run what it tells them: give only one that you trust."""

    def __post_init__(self) -> None:
        if self.workers is not None and self.scheduler is not None:
            raise OptionError("give `workers` or `scheduler`, not both")


DEFAULT_STEPS, DEFAULT_ENGINE = Steps(), Engine()


def batch(
    pairs: Annotated[
        Path,
        Parameter(
            help="A CSV file with the columns source and target, and if need be source_landmarks, "
            "target_landmarks, name and kind (splats or pictures); its paths start from its folder."
        ),
    ],
    /,
    *,
    out: Out = None,
    fitting: FittingOptions = DEFAULT_FITTING,
    posing: PosingOptions = DEFAULT_POSING,
    auto: Auto = True,
    steps: Steps = DEFAULT_STEPS,
    engine: Engine = DEFAULT_ENGINE,
    device: Device = "cpu",
    overwrite: Overwrite = False,
    json: Json = False,
) -> int:
    """Fit every pair of a table into a folder of runs, and sum them up in summary.csv and .html.

    A pair that is wrong doesn't stop the others. The same command again goes on where it was
    stopped: what was made of the same inputs and options is kept; that of others needs -w. Exits
    with 3 where none failed but many landmarks of a pair are missed by far.
    """
    from splatmorph.app.rows import Asked, Task
    from splatmorph.io.atomic import make_folder
    from splatmorph.runs.batch import alone, read_rows
    from splatmorph.runs.summary import write_page, write_summary

    rows = read_rows(pairs)
    asked = Asked(fitting, posing, Finding(auto), steps.words(), device, overwrite)
    shown = out or Path(f"{pairs.stem}-runs")
    folder = make_folder(shown).absolute()
    tasks = [Task(row, folder, asked) for row in rows]
    done: dict[int, Result] = {}
    with alone(folder):
        try:
            for number, result in _results(tasks, engine, json):
                done[number] = result
                if result.status == "failed":
                    console.fail(f"{result.name}: {result.message}")
        finally:
            results = [done[number] for number in sorted(done)]
            if results:  # else no worker was found: what another batch has summed up stays
                write_summary(folder / SUMMARY, results)
                write_page(folder / PAGE, results, pairs.stem)
    if json:
        console.emit_json({"pairs": [dataclasses.asdict(result) for result in results]})
    else:
        console.say(_table(results))
        console.say("")
        console.say(f"wrote {shown / SUMMARY}")
        console.say(f"wrote {shown / PAGE}")
    return _verdict(results, shown / SUMMARY)


def _results(tasks: Sequence[Task], engine: Engine, json: bool) -> Iterator[tuple[int, Result]]:
    """Which row is done, and what became of it, as they come."""
    if engine == DEFAULT_ENGINE:
        yield from _one_by_one(tasks, json)
        return
    from splatmorph.app.rows import work_silently
    from splatmorph.runs.batch import Result
    from splatmorph.runs.cluster import Lost, gather, local_cluster, remote_cluster

    if engine.scheduler is None:
        cluster = local_cluster(min(engine.workers or 1, len(tasks)))
    else:
        console.note(f"asking the workers at {engine.scheduler}")
        cluster = remote_cluster(engine.scheduler, tasks[0].folder)
    with cluster as client, console.progress("pairs") as update:
        update(0, len(tasks), "")
        for count, (number, answer) in enumerate(gather(client, work_silently, tasks), 1):
            name = tasks[number].row.name
            if isinstance(answer, Lost):
                result = Result(name, "failed", message=answer.reason)
            else:
                result, warnings = answer
                for warning in warnings:
                    console.warn(f"{name}: {warning}")
            console.note(f"{count}/{len(tasks)} {name} {result.status}")
            update(count, len(tasks), "")
            yield number, result


def _one_by_one(tasks: Sequence[Task], json: bool) -> Iterator[tuple[int, Result]]:
    from splatmorph.app.rows import work, work_silently

    for number, task in enumerate(tasks):
        console.note(f"{number + 1}/{len(tasks)} {task.row.name}")
        if json:  # of which nothing else may be printed
            result, warnings = work_silently(task)
            for warning in warnings:
                console.warn(f"{task.row.name}: {warning}")
            yield number, result
            continue
        with console.fitting() as on_step:
            yield number, work(task, on_step, console.warn)


def _verdict(results: Sequence[Result], summary: Path) -> int:
    """The exit code.

    Raises:
        FitError: a row failed.
    """
    failed = [result.name for result in results if result.status == "failed"]
    if failed:
        raise FitError(
            f"{len(failed)} of {len(results)} pairs failed ({', '.join(failed[:5])}"
            f"{', …' if len(failed) > 5 else ''}), {summary} says why: mend them and give "
            "the same command again"
        )
    missed = [result.name for result in results if result.status == "missed"]
    for name in missed:
        console.warn(f"{name} misses many of its landmarks by far; {summary} says which")
    return console.MISSED if missed else 0


def _table(results: Sequence[Result]) -> Any:
    made = console.table("pair", "", "landmarks", "rms error", "worst error", "min det", "time")
    # A name is needed in full, to type it.
    made.columns[0].overflow = "fold"
    for one in results:
        numbers = [
            "" if value is None else f"{value:.3g}"
            for value in (one.landmarks, one.rms_error, one.worst_error, one.det_min)
        ]
        took = "" if one.seconds is None else f"{one.seconds:.1f} s"
        made.add_row(one.name, one.status, *numbers, took)
    return made
