"""``splatmorph export``: the splats between, as PLY files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.options import (
    AS_THEY_ARE,
    Blending,
    Out,
    Overwrite,
    RunPath,
    TimesOption,
)
from splatmorph.errors import OptionError
from splatmorph.export import export_sequence
from splatmorph.inputs import fingerprint
from splatmorph.run import MANIFEST, WEIGHTS, load_run, open_run


def export(
    run: RunPath,
    /,
    *,
    out: Out = None,
    frames: Annotated[
        int | None, Parameter(help="How many, evenly from t = 0 to 1; 5 if neither is given.")
    ] = None,
    t: TimesOption = None,
    prune: Annotated[
        bool, Parameter(help="Leave out splats too faint to be drawn (alpha below 1/255).")
    ] = True,
    blending: Blending = AS_THEY_ARE,
    overwrite: Overwrite = False,
) -> None:
    """Write the morph as PLY files, one a time, and frames.json with the t of each.

    The files are named so that SuperSplat and Brush play them as a sequence. An interrupted
    export goes on when the same command is given again.
    """
    times = _times(frames, t.values if t else None, bool(t and t.stretch))
    options = blending.chosen()
    source, target = (one.name for one in open_run(run).inputs[:2])
    morph = load_run(run, **options)
    folder = out or Path(f"{run.resolve().name.removesuffix('.run')}-frames")
    with console.progress("writing") as update:
        written = export_sequence(
            morph,
            times,
            folder,
            names=(source, target),
            prune=prune,
            overwrite=overwrite,
            asked=options | {"run": fingerprint((run / MANIFEST, run / WEIGHTS))},
            on_frame=lambda done: update(done, len(times), ""),
        )
    if written.resumed:
        console.say(f"{written.resumed} frames were there from an interrupted export")
    if written.pruned:
        console.say(f"left out {written.pruned:,} splats too faint to be drawn (--no-prune keeps)")
    console.say(f"wrote {len(written.files)} files, {written.files[0].name} …, to {folder}")


def _times(frames: int | None, values: tuple[float, ...] | None, stretch: bool) -> list[float]:
    if frames is not None and frames < 1:
        raise OptionError(f"--frames is {frames}, expected at least 1")
    if values is not None and not stretch:
        if frames is not None and frames != len(values):
            raise OptionError(f"--frames {frames} and {len(values)} times in --t: give one of them")
        return list(values)
    start, end = values or (0.0, 1.0)
    count = frames or 5
    return [start + (end - start) * (i / (count - 1) if count > 1 else 0.0) for i in range(count)]
