"""What stands before the camera when ``splatmorph render`` is called."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from renderer import Camera, orbit, read_cameras
from splatmorph.app import console
from splatmorph.app.options import Times, Viewpoint, check_reach, frame_times
from splatmorph.avatars import Drive, is_avatar, track_of
from splatmorph.errors import OptionError
from splatmorph.gaussians import Gaussians
from splatmorph.rendering import SWING, bounds, turntable, upright
from splatmorph.runs.inputs import load_splat
from splatmorph.runs.run import open_run

FULL_CIRCLE = 360.0
SHEET_COLUMNS = 5


@dataclass(frozen=True)
class Shot:
    """What is in front of the camera, frame by frame."""

    splats: Iterator[Gaussians]
    extent: tuple[Gaussians, ...]
    """What must stay in the picture all the time."""
    swing: float
    """Degrees that show it well: heads made from single pictures have no back."""


def shot_of(
    what: Path, t: Times | None, count: int, blending: dict[str, Any], drive: Path | None
) -> Shot:
    if not what.is_dir() or is_avatar(what):
        splat = load_splat(what).gaussians
        return Shot(iter([splat] * count), (splat,), FULL_CIRCLE)
    run = open_run(what)
    inputs = run.load_inputs()
    if run.is_mean:
        splat = run.average(inputs, **blending)
        return Shot(iter([splat] * count), (splat,), SWING)
    times = frame_times(t, count, len(inputs) - 1)
    # In the source's place the object stays before the camera, wherever the captures stand.
    morph = run.morph(inputs, stay=True, **blending).in_place()
    extent = tuple(morph.sequence(range(len(inputs))))
    if drive is None:
        console.prepare(morph, times)
        return Shot(morph.sequence(times), extent, SWING)
    avatars = [one.avatar for one in inputs]
    if len(avatars) != 2 or avatars[0] is None or avatars[1] is None:
        raise OptionError(f"--drive moves rigged avatars, but {what} is a run of other splats")
    leg, track = run.legs[0], track_of(drive)
    blending |= {"landmarks": leg.source_points, "frame": leg.frame, "stay": True}
    driven = Drive(avatars[0], avatars[1], leg.flow, track, **blending)
    console.prepare(driven, times)
    return Shot(driven.sequence(times), extent, SWING)


def sheet_of(
    what: Path,
    t: Times | None,
    view: Viewpoint,
    blending: dict[str, Any],
    background: Sequence[float] | None,
    parts: bool,
    device: str,
) -> Any:
    from splatmorph.view.sheet import contact_sheet, views

    degrees = SWING if view.orbit is None else view.orbit
    width, height = view.size

    def cameras(upright_one: Gaussians, *splats: Gaussians) -> list[Camera]:
        return orbit(
            bounds(*splats),
            [view.azimuth - degrees, view.azimuth, view.azimuth + degrees],
            elevation=view.elevation,
            up=upright(upright_one, view.up),
            width=width,
            height=height,
        )

    paper = background or (1.0, 1.0, 1.0)
    still = still_of(what, blending)
    if still is not None:
        if t is not None or parts:
            raise OptionError(f"{what} is one splat, which has no t and no parts: expected a run")
        name = what.resolve().stem
        return views(still, cameras(still, still), name, background=paper, device=device)
    run = open_run(what)
    inputs = run.load_inputs()
    last = len(inputs) - 1
    if t is not None:
        check_reach(t.values, last)
    if t is None or t.stretch:
        start, end = t.values if t else (0.0, float(last))
        times = [start + (end - start) * i / (SHEET_COLUMNS - 1) for i in range(SHEET_COLUMNS)]
    else:
        times = list(t.values)
    morph = run.morph(inputs, stay=True, **blending).in_place()
    around = cameras(inputs[0].gaussians, *morph.sequence(range(len(inputs))))
    console.prepare(morph, times)
    return contact_sheet(morph, times, around, background=paper, parts=parts, device=device)


def still_of(what: Path, blending: dict[str, Any]) -> Gaussians | None:
    """The one splat that ``what`` is, a file, an avatar or an average; None for a run with a t."""
    if not what.is_dir() or is_avatar(what):
        return load_splat(what).gaussians
    run = open_run(what)
    return run.average(run.load_inputs(), **blending) if run.is_mean else None


def cameras_of(view: Viewpoint, shot: Shot, count: int) -> Sequence[Camera]:
    if view.cameras is not None:
        path = read_cameras(view.cameras, size=view.size)
        return [path[i * len(path) // count] for i in range(count)]
    return turntable(
        bounds(*shot.extent),
        count,
        degrees=shot.swing if view.orbit is None else view.orbit,
        azimuth=view.azimuth,
        elevation=view.elevation,
        up=upright(shot.extent[0], view.up),
        size=view.size,
    )
