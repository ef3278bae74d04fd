"""``splatmorph export``: the splats between, as files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from splatmorph import io
from splatmorph.app import console
from splatmorph.app.options import (
    DEFAULT_BLENDING,
    Blending,
    Out,
    Overwrite,
    RunPath,
    Times,
    TimesOption,
)
from splatmorph.errors import OptionError
from splatmorph.runs.export import Exported, export_one, export_sequence, write_measured
from splatmorph.runs.inputs import fingerprint
from splatmorph.runs.run import MANIFEST, WEIGHTS, open_run


def export(
    run: RunPath,
    /,
    *,
    out: Out = None,
    frames: Annotated[
        int | None,
        Parameter(help="How many, evenly from first to last t; 5 by default."),
    ] = None,
    t: TimesOption = None,
    format: Annotated[
        Literal["ply", "compressed.ply", "spz", "sog", "splat", "glb", "gltf"] | None,
        Parameter(help="ply by default, which alone keeps every bit; the others are smaller."),
    ] = None,
    prune: Annotated[
        bool, Parameter(help="Leave out splats too faint to be drawn (alpha below 1/255).")
    ] = True,
    stable_count: Annotated[
        bool,
        Parameter(negative="", help="Keep every splat in every frame, for players that need it."),
    ] = False,
    stay: Annotated[
        bool,
        Parameter(
            negative="",
            help="Keep every frame in the source's place, the target moved there rigidly; else "
            "the frames go from where the one stands to where the other does.",
        ),
    ] = False,
    blending: Blending = DEFAULT_BLENDING,
    overwrite: Overwrite = False,
) -> None:
    """Write the morph as splat files, one a time, and frames.json with the t of each.

    -o x.spz with one --t writes that one file; otherwise -o is a folder. PLY files are named so
    that SuperSplat and Brush play them as a sequence. An interrupted export goes on when the same
    command is given again.
    """
    single = _names_a_file(out, format)
    options: dict[str, Any] = blending.chosen()
    opened = open_run(run)
    inputs = opened.load_inputs()
    stem = run.resolve().name.removesuffix(".run")
    if opened.is_mean:
        path = console.claim(out or Path(f"{stem}.{format or 'ply'}"), overwrite)
        moved = write_measured(path, opened.average(inputs, **options))
        console.say(f"wrote {path}{lossy(path, moved)}")
        return
    if stable_count:
        options["stable_count"], prune = True, False
    if stay:
        options["stay"] = True
    times = _times(frames, t, len(inputs) - 1)
    if single and len(times) > 1:
        raise OptionError(
            f"-o {out} is one file for {len(times)} times: give --t 0.5, or a folder to -o"
        )
    morph = opened.morph(inputs, **options)
    names = [one.name for one in opened.inputs]
    if single and out:
        written = export_one(
            morph, times[0], console.claim(out, overwrite), names=names, prune=prune
        )
        _say_written(written, str(out))
        return
    folder = out or Path(f"{stem}-frames")
    with console.progress("writing") as update:
        written = export_sequence(
            morph,
            times,
            folder,
            extension=f".{format or 'ply'}",
            names=names,
            prune=prune,
            overwrite=overwrite,
            asked=options | {"run": fingerprint((run / MANIFEST, run / WEIGHTS))},
            on_frame=lambda done: update(done, len(times), ""),
        )
    if written.resumed:
        console.say(f"{written.resumed} frames were there from an interrupted export")
    _say_written(written, f"{len(written.files)} files, {written.files[0].name} …, to {folder}")


def _names_a_file(out: Path | None, format: str | None) -> bool:
    """Whether ``out`` is one file, by its extension; a folder of frames otherwise.

    Raises:
        OptionError: an extension that is no format's, or not that of ``format``.
    """
    if out is None or out.is_dir():
        return False
    extension = io.extension_of(out)
    if extension in io.FORMATS:
        if format not in (None, extension[1:]):
            raise OptionError(f"--format {format} and -o {out} are different formats: give one")
        return True
    # A folder may be called v1.2, or .frames.
    if re.fullmatch(r"\.[a-z]\w*", extension):
        raise OptionError(
            f"-o {out} has an extension we don't write: expected a folder, or one file of "
            f"{', '.join(sorted(io.FORMATS))}"
        )
    return False


def _say_written(written: Exported, what: str) -> None:
    if written.pruned:
        console.say(f"left out {written.pruned:,} splats too faint to be drawn (--no-prune keeps)")
    console.say(f"wrote {what}{lossy(written.files[0], written.moved)}")


def lossy(path: Path, moved: float) -> str:
    """What the line of an output says where its format doesn't keep every bit."""
    loses = io.FORMATS[io.extension_of(path)].loses
    centers = f"centers moved by up to {moved:.2g}" if moved else "centers kept"
    return f"; lossy: {centers}, {loses}" if loses else ""


def _times(frames: int | None, t: Times | None, last: float) -> list[float]:
    if frames is not None and frames < 1:
        raise OptionError(f"--frames is {frames}, expected at least 1")
    if t is not None and not t.stretch:
        if frames not in (None, len(t.values)):
            raise OptionError(f"--frames {frames} and {len(t.values)} times in --t: give one")
        return list(t.values)
    start, end = t.values if t is not None else (0.0, last)
    count = frames or 5
    return [start + (end - start) * (i / (count - 1) if count > 1 else 0.0) for i in range(count)]
