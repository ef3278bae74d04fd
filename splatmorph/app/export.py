"""``splatmorph export``: Write the splats between as files, one a time."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

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
from splatmorph.timeline import STILL, Timeline

AXES = {"y-up": "y", "y-down": "-y", "z-up": "z"}
SAMPLES, FRAMES = 25, 5


def frame_formats() -> list[str]:
    """What the frames in a folder may be."""
    from splatmorph import io

    return [one[1:] for one in io.written() if one[0] == "." and not io.FORMATS[one].animated]


def _check_kind(type_: Any, kind: str | None) -> None:
    if kind is not None and kind not in frame_formats():
        raise ValueError(f"Choose one of {', '.join(frame_formats())}.")


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
            "compressed.ply, glb, gltf, sog, splat, spz.",
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
    from splatmorph import io
    from splatmorph.app.exporting import Job, lossy, to_animation, to_file, to_folder
    from splatmorph.io.axes import upright
    from splatmorph.runs.export import write_measured
    from splatmorph.runs.inputs import fingerprint
    from splatmorph.runs.run import MANIFEST, WEIGHTS, open_run

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
    job = Job(opened, opened.morph(inputs, **options), times, prune, up)
    if file:
        console.claim(file, overwrite)
        if animated:
            to_animation(job, file, timeline)
        else:
            to_file(job, file)
        return
    asked = options | {"run": fingerprint((run / MANIFEST, run / WEIGHTS))}
    to_folder(job, out or Path(f"{stem}-frames"), f".{format or 'ply'}", overwrite, asked)


def _names_a_file(out: Path, format: str | None) -> bool:
    """Whether ``out`` is one file, by its extension; a folder of frames otherwise.

    Raises:
        OptionError: an extension that is no format's, or not that of ``format``.
    """
    from splatmorph import io

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
