"""``splatmorph render``: Render a run as a video or pictures; or any splat."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.options import (
    DEFAULT_BLENDING,
    DEFAULT_VIEWPOINT,
    Blending,
    ColourOption,
    Device,
    Out,
    Overwrite,
    TimesOption,
    Viewpoint,
    choose_device,
)
from splatmorph.errors import OptionError

STILLS = (".png", ".jpg", ".jpeg", ".webp")
WITH_ALPHA = ("", ".png", ".webp")


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
    from renderer import check_output, write_image, write_video
    from splatmorph.app.shots import cameras_of, sheet_of, shot_of
    from splatmorph.rendering import pictures

    ending = "-sheet.png" if sheet else ".mp4"
    path = console.claim(out or Path(f"{what.resolve().stem}{ending}"), overwrite)
    check_output(path)
    kind = path.suffix.lower()
    if background is None and kind not in WITH_ALPHA:
        raise OptionError(f"{path.name} can't be transparent: write a .png or a folder of frames")
    if sheet:
        picture = sheet_of(
            what, t, view, blending.chosen(), background, parts, choose_device(device)
        )
        console.say(f"wrote {write_image(path, picture)}")
        return
    count = 1 if kind in STILLS else frames
    shot = shot_of(what, t, count, blending.chosen(), drive)
    cameras = cameras_of(view, shot, count)
    with console.progress("rendering") as update:
        drawn = pictures(shot.splats, cameras, background=background, device=choose_device(device))

        def on_frame(done: int, rate: float) -> None:
            update(done, count, f"{rate:.0f} frames a second")

        if kind in STILLS:
            written = write_image(path, next(drawn))
        else:
            written = write_video(path, drawn, fps, on_frame=on_frame)
    console.say(f"wrote {written}")
