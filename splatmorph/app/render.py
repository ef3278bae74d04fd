"""``splatmorph render``: Render a run as a video or pictures; or any splat."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from renderer import Camera, check_output, orbit, read_cameras, write_image, write_video
from splatmorph.app import console
from splatmorph.app.options import (
    DEFAULT_BLENDING,
    DEFAULT_VIEWPOINT,
    Blending,
    ColourOption,
    Device,
    Out,
    Overwrite,
    Times,
    TimesOption,
    Viewpoint,
    check_reach,
    choose_device,
)
from splatmorph.avatars import Drive, is_avatar, track_of
from splatmorph.errors import OptionError
from splatmorph.gaussians import Gaussians
from splatmorph.rendering import SWING, bounds, there_and_back, turntable, upright
from splatmorph.rendering import render as render_frame
from splatmorph.runs.inputs import load_splat
from splatmorph.runs.run import open_run

STILLS = (".png", ".jpg", ".jpeg", ".webp")
WITH_ALPHA = ("", ".png", ".webp")
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


def render(
    what: Annotated[Path, Parameter(help="A run directory, a splat file or an avatar.")],
    /,
    *,
    out: Out = None,
    t: TimesOption = None,
    frames: Annotated[int, Parameter(help="How many frames.")] = 120,
    fps: Annotated[float, Parameter(help="Frames a second.")] = 30.0,
    view: Viewpoint = DEFAULT_VIEWPOINT,
    background: ColourOption = (1.0, 1.0, 1.0),
    blending: Blending = DEFAULT_BLENDING,
    drive: Annotated[
        Path | None,
        Parameter(help="A FLAME track (flame_param.npz, or an avatar) that moves both avatars."),
    ] = None,
    sheet: Annotated[
        bool,
        Parameter(negative="", help="One picture of all: t across, five by default; views down."),
    ] = False,
    parts: Annotated[
        bool,
        Parameter(negative="", help="In the sheet, show the two halves of the morph singly too."),
    ] = False,
    device: Device = "cpu",
    overwrite: Overwrite = False,
) -> None:
    """Render a run: by default a turntable that swings round while t goes 0 → 1 → 0.

    --t 0.5 holds one t; --t 0:1 goes one way. The output's extension chooses: .mp4, .gif, a .png
    for one picture (from the front unless --azimuth says otherwise), or a folder of PNG frames.
    """
    ending = "-sheet.png" if sheet else ".mp4"
    path = console.claim(out or Path(f"{what.resolve().stem}{ending}"), overwrite)
    check_output(path)
    kind = path.suffix.lower()
    if background is None and kind not in WITH_ALPHA:
        raise OptionError(f"{path.name} can't be transparent: write a .png or a folder of frames")
    if sheet:
        picture = _sheet(what, t, view, blending.chosen(), background, parts, choose_device(device))
        console.say(f"wrote {write_image(path, picture)}")
        return
    count = 1 if kind in STILLS else frames
    shot = _shot(what, t, count, blending.chosen(), drive)
    cameras = _cameras(view, shot, count)
    with console.progress("rendering") as update:

        def pictures() -> Iterator[Any]:
            for splat, camera in zip(shot.splats, cameras, strict=True):
                yield render_frame(
                    splat, camera, background=background, device=choose_device(device)
                )

        def on_frame(done: int, rate: float) -> None:
            update(done, count, f"{rate:.0f} frames a second")

        if kind in STILLS:
            written = write_image(path, next(pictures()))
        else:
            written = write_video(path, pictures(), fps, on_frame=on_frame)
    console.say(f"wrote {written}")


def _shot(
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
    morph = run.morph(inputs, stay=True, **blending)
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


def _sheet(
    what: Path,
    t: Times | None,
    view: Viewpoint,
    blending: dict[str, Any],
    background: Sequence[float] | None,
    parts: bool,
    device: str,
) -> Any:
    from splatmorph.view.sheet import contact_sheet

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
    degrees = SWING if view.orbit is None else view.orbit
    width, height = view.size
    morph = run.morph(inputs, stay=True, **blending)
    cameras = orbit(
        bounds(*morph.sequence(range(len(inputs)))),
        [view.azimuth - degrees, view.azimuth, view.azimuth + degrees],
        elevation=view.elevation,
        up=upright(inputs[0].gaussians, view.up),
        width=width,
        height=height,
    )
    console.prepare(morph, times)
    return contact_sheet(
        morph,
        times,
        cameras,
        background=background or (1.0, 1.0, 1.0),
        parts=parts,
        device=device,
    )


def _cameras(view: Viewpoint, shot: Shot, count: int) -> Sequence[Camera]:
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


def frame_times(t: Times | None, count: int, last: float = 1.0) -> list[float]:
    """The t of each frame: there and back again by default, one held, or a stretch one way.

    Raises:
        OptionError: a list whose length is not the number of frames.
    """
    if t is not None:
        check_reach(t.values, last)
    if t is None:
        return there_and_back(count, end=last) if count > 1 else [last / 2]
    if t.stretch:
        start, end = t.values
        return [start + (end - start) * i / max(1, count - 1) for i in range(count)]
    if len(t.values) == 1:
        return [t.values[0]] * count
    if len(t.values) != count:
        raise OptionError(
            f"--t lists {len(t.values)} times for {count} frames: give one to hold, a stretch "
            f"such as 0:1, or --frames {len(t.values)}"
        )
    return list(t.values)
