"""``splatmorph export``: Write the splats between as files, one a time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
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
    check_reach,
)
from splatmorph.errors import OptionError
from splatmorph.io.axes import upright
from splatmorph.io.usd import STILL, Timeline
from splatmorph.morph import Morph
from splatmorph.morph.chain import Chain
from splatmorph.runs.export import (
    Exported,
    export_animation,
    export_one,
    export_sequence,
    turned_landmarks,
    write_measured,
)
from splatmorph.runs.inputs import fingerprint
from splatmorph.runs.run import MANIFEST, WEIGHTS, Run, open_run

AXES = {"y-up": "y", "y-down": "-y", "z-up": "z"}
SAMPLES, FRAMES = 25, 5
FRAME_FORMATS = [one[1:] for one in io.written() if one[0] == "." and not io.FORMATS[one].animated]
"""Of the frames in a folder."""


def _check_kind(type_: Any, kind: str | None) -> None:
    if kind is not None and kind not in FRAME_FORMATS:
        raise ValueError(f"Choose one of {', '.join(FRAME_FORMATS)}.")


def export(
    run: RunPath,
    /,
    *,
    out: Out = None,
    frames: Annotated[
        int | None,
        Parameter(help="How many, evenly from first to last t; 5 by default, 25 in USD."),
    ] = None,
    t: TimesOption = None,
    format: Annotated[
        str | None,
        Parameter(
            validator=_check_kind,
            help="ply by default, which alone keeps every bit; the others are smaller: "
            f"{', '.join(FRAME_FORMATS)}.",
        ),
    ] = None,
    axes: Annotated[
        Literal["y-up", "y-down", "z-up"] | None,
        Parameter(help="Turn the splats to these axes; as they are by default (glTF has y up)."),
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
    timeline: Annotated[Timeline, Parameter(name="*")] = STILL,
    blending: Blending = DEFAULT_BLENDING,
    overwrite: Overwrite = False,
) -> None:
    """Write the morph as splat files, one a time, and frames.json with the t of each.

    -o x.spz with one --t writes that one file, -o x.usdc the whole morph as one that plays
    (Omniverse, Houdini); otherwise -o is a folder. PLY files are named so that SuperSplat and
    Brush play them as a sequence. An interrupted export goes on when the same command is given
    again.
    """
    file = out if out and _names_a_file(out, format) else None
    options: dict[str, Any] = blending.chosen()
    opened = open_run(run)
    inputs = opened.load_inputs()
    up = AXES[axes] if axes else None
    stem = run.resolve().name.removesuffix(".run")
    if opened.is_mean:
        path = console.claim(out or Path(f"{stem}.{format or 'ply'}"), overwrite)
        average = opened.average(inputs, **options)
        moved = write_measured(path, upright(average, up) if up else average)
        console.say(f"wrote {path}{lossy(path, moved)}")
        return
    animated = file is not None and io.FORMATS[io.extension_of(file)].animated
    times = _times(frames, t, len(inputs) - 1, SAMPLES if animated else FRAMES)
    animated = animated and len(times) > 1
    if file and not animated and len(times) > 1:
        raise OptionError(
            f"-o {out} is one file for {len(times)} times: give --t 0.5, or a folder to -o"
        )
    if stable_count or (animated and len(inputs) == 2):
        options["stable_count"], prune = True, False
    if stay:
        options["stay"] = True
    job = _Job(opened, opened.morph(inputs, **options), times, prune, up)
    if file:
        console.claim(file, overwrite)
        if animated:
            _to_animation(job, file, timeline)
        else:
            _to_file(job, file)
        return
    asked = options | {"run": fingerprint((run / MANIFEST, run / WEIGHTS))}
    _to_folder(job, out or Path(f"{stem}-frames"), f".{format or 'ply'}", overwrite, asked)


@dataclass(frozen=True)
class _Job:
    """What is exported, wherever to."""

    run: Run
    morph: Morph | Chain
    times: Sequence[float]
    prune: bool
    up: str | None

    @property
    def names(self) -> list[str]:
        return [one.name for one in self.run.inputs]


def _to_animation(job: _Job, file: Path, timeline: Timeline) -> None:
    console.prepare(job.morph, job.times)
    with console.progress("writing") as update:
        plain = export_animation(
            job.morph,
            job.times,
            file,
            timeline=timeline,
            names=job.names,
            up=job.up,
            on_frame=lambda done: update(done, len(job.times), ""),
        )
    size, count = file.stat().st_size / 1e6, timeline.seconds * timeline.fps
    console.say(
        f"wrote {file}: {len(job.times)} samples over {timeline.seconds:g} s, {size:,.1f} MB "
        f"(as {count:.0f} .ply files {plain / len(job.times) * count / 1e6:,.1f} MB)"
    )


def _to_file(job: _Job, file: Path) -> None:
    (t,) = job.times
    console.prepare(job.morph, job.times)
    written = export_one(job.morph, t, file, names=job.names, prune=job.prune, up=job.up)
    _say_written(written, str(file))
    leg = job.run.legs[0]
    if isinstance(job.morph, Morph):
        marks = turned_landmarks(job.morph, leg.source_points, leg.names, t, file, job.up)
        if marks is not None:
            beside = file.with_name(f"{io.stem_of(file)}.landmarks.json")
            marks.write(beside)
            console.say(f"wrote {beside}, turned along with the splats")
    _say_who_turns(file)


def _to_folder(
    job: _Job, folder: Path, extension: str, overwrite: bool, asked: dict[str, Any]
) -> None:
    with console.progress("writing") as update:
        written = export_sequence(
            job.morph,
            job.times,
            folder,
            extension=extension,
            names=job.names,
            prune=job.prune,
            up=job.up,
            overwrite=overwrite,
            asked=asked,
            on_frame=lambda done: update(done, len(job.times), ""),
            on_prepare=lambda done, steps: update(0, len(job.times), f"agreeing {done}/{steps}"),
        )
    if written.resumed:
        console.say(f"{written.resumed} frames were there from an interrupted export")
    _say_written(written, f"{len(written.files)} files, {written.files[0].name} …, to {folder}")
    _say_who_turns(written.files[0])


def _say_who_turns(file: Path) -> None:
    if io.extension_of(file) == ".spz":
        console.say(
            "SPZ to PLY: splat-transform and Niantic's tools turn it by 180° about x, "
            "gsply and gaussforge don't"
        )


def _names_a_file(out: Path, format: str | None) -> bool:
    """Whether ``out`` is one file, by its extension; a folder of frames otherwise.

    Raises:
        OptionError: an extension that is no format's, or not that of ``format``.
    """
    if out.is_dir():
        return False
    extension = io.extension_of(out)
    if extension in io.written():
        if format not in (None, extension[1:]):
            raise OptionError(f"--format {format} and -o {out} are different formats: give one")
        return True
    # A folder may be called v1.2, or .frames.
    if re.fullmatch(r"\.[a-z]\w*", extension):
        raise OptionError(
            f"-o {out} has an extension we don't write: expected a folder, or one file of "
            f"{', '.join(io.written())}"
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


def _times(frames: int | None, t: Times | None, last: float, usual: int) -> list[float]:
    if t is not None:
        check_reach(t.values, last)
    if t is not None and not t.stretch:
        if frames not in (None, len(t.values)):
            raise OptionError(f"--frames {frames} and {len(t.values)} times in --t: give one")
        return list(t.values)
    start, end = t.values if t is not None else (0.0, last)
    count = frames or usual
    return [start + (end - start) * (i / (count - 1) if count > 1 else 0.0) for i in range(count)]
