"""What ``splatmorph export`` does, and says of what was written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splatmorph import io
from splatmorph.app import console
from splatmorph.morph import Chain, Morph
from splatmorph.runs.export import (
    Exported,
    export_animation,
    export_one,
    export_sequence,
    turned_landmarks,
)
from splatmorph.runs.run import Run
from splatmorph.timeline import Timeline


@dataclass(frozen=True)
class Job:
    """What is exported, wherever to."""

    run: Run
    morph: Morph | Chain
    times: Sequence[float]
    prune: bool
    up: str | None

    @property
    def names(self) -> list[str]:
        return [one.name for one in self.run.inputs]


def to_animation(job: Job, file: Path, timeline: Timeline) -> None:
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


def to_file(job: Job, file: Path) -> None:
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


def to_folder(
    job: Job, folder: Path, extension: str, overwrite: bool, asked: dict[str, Any]
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


def _say_written(written: Exported, what: str) -> None:
    if written.pruned:
        console.say(f"left out {written.pruned:,} splats too faint to be drawn (--no-prune keeps)")
    console.say(f"wrote {what}{lossy(written.files[0], written.moved)}")


def lossy(path: Path, moved: float) -> str:
    """What the line of an output says where its format doesn't keep every bit."""
    loses = io.FORMATS[io.extension_of(path)].loses
    centers = f"centers moved by up to {moved:.2g}" if moved else "centers kept"
    return f"; lossy: {centers}, {loses}" if loses else ""
