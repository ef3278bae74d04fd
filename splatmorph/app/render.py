"""``splatmorph render``: pictures and videos of a run, or of any splat."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from renderer import Camera, read_transforms, write_image, write_video
from splatmorph.app import console
from splatmorph.app.options import (
    ColourOption,
    CovarianceOption,
    Device,
    EaseOption,
    Out,
    Overwrite,
    RampOption,
    Size,
    SizeOption,
    Times,
    TimesOption,
    choose_device,
)
from splatmorph.errors import OptionError
from splatmorph.gaussians import Gaussians
from splatmorph.inputs import load_splat
from splatmorph.rendering import SWING, bounds, there_and_back, turntable
from splatmorph.rendering import render as render_frame
from splatmorph.run import MANIFEST, load_run

DEFAULT_SIZE = Size(512, 512)
STILLS = (".png", ".jpg", ".jpeg", ".webp")


@dataclass(frozen=True)
class Shot:
    """What is in front of the camera, frame by frame, and the sphere that holds it all."""

    frames: Iterator[Gaussians]
    extent: tuple[Gaussians, ...]


def render(
    what: Annotated[Path, Parameter(help="A run directory, a splat file or an avatar.")],
    /,
    *,
    out: Out = None,
    t: TimesOption = None,
    frames: Annotated[int, Parameter(help="How many frames.")] = 120,
    fps: Annotated[float, Parameter(help="Frames a second.")] = 30.0,
    size: SizeOption = DEFAULT_SIZE,
    orbit: Annotated[
        float | None,
        Parameter(help="Degrees the camera swings to each side; 360 for full circles."),
    ] = None,
    azimuth: Annotated[float, Parameter(help="Degrees from the front where it begins.")] = 0.0,
    elevation: Annotated[float, Parameter(help="Degrees above the object.")] = 0.0,
    up: Annotated[str, Parameter(help="The axis that points up: y, -y, z or -z.")] = "y",
    cameras: Annotated[
        Path | None, Parameter(help="A transforms.json of NeRF or nerfstudio, instead of --orbit.")
    ] = None,
    background: ColourOption = (1.0, 1.0, 1.0),
    ramp: RampOption = None,
    covariance: CovarianceOption = None,
    ease: EaseOption = None,
    device: Device = "cpu",
    overwrite: Overwrite = False,
) -> None:
    """Render a run: by default a turntable that swings round while t goes 0 → 1 → 0.

    --t 0.5 holds one t; --t 0:1 goes one way. The output's extension chooses: .mp4, .gif, a .png
    for one picture (from the front unless --azimuth says otherwise), or a folder of PNG frames.
    """
    is_run = what.is_dir() and (what / MANIFEST).exists()
    path = console.claim(out or Path(f"{what.name.removesuffix(what.suffix)}.mp4"), overwrite)
    still = path.suffix.lower() in STILLS
    if frames < 1 or fps <= 0:
        raise OptionError(f"{frames} frames at {fps} a second: expected at least 1, above 0")
    count = 1 if still else frames
    times = _times(t, count, still)
    if cameras is not None:
        views = read_transforms(cameras, size=size)
        views = [views[i * len(views) // count] for i in range(count)]
    if is_run:
        chosen = {"ramp": ramp, "covariance": covariance, "ease": ease}
        morph = load_run(what, **{k: v for k, v in chosen.items() if v is not None})
        shot = Shot(morph.sequence(times), (morph.source, morph.target))
    else:
        splat = load_splat(what).gaussians
        shot = Shot(iter([splat] * count), (splat,))
    if cameras is None:
        degrees = orbit if orbit is not None else SWING if is_run else 360.0
        views = turntable(
            bounds(*shot.extent),
            count,
            degrees=degrees,
            azimuth=azimuth,
            elevation=elevation,
            up=up,
            size=size,
        )
    _write(path, shot.frames, views, background, fps, choose_device(device))


def _times(t: Times | None, count: int, still: bool) -> list[float]:
    if t is None:
        return there_and_back(count) if not still else [0.5]
    if not t.stretch:
        if len(t.values) not in (1, count):
            raise OptionError(
                f"--t lists {len(t.values)} times for {count} frames: give one to hold, a stretch "
                f"such as 0:1, or --frames {len(t.values)}"
            )
        return list(t.values) * (count if len(t.values) == 1 else 1)
    start, end = t.values
    return [start + (end - start) * i / max(1, count - 1) for i in range(count)]


def _write(
    path: Path,
    splats: Iterator[Gaussians],
    views: Sequence[Camera],
    background: Sequence[float] | None,
    fps: float,
    device: str,
) -> None:
    with console.progress("rendering") as update:

        def pictures() -> Iterator[object]:
            for i, (splat, camera) in enumerate(zip(splats, views, strict=True)):
                yield render_frame(splat, camera, background=background, device=device)
                update(i + 1, len(views))

        if path.suffix.lower() in STILLS:
            write_image(path, next(pictures()))
        else:
            write_video(path, pictures(), fps)
    console.say(f"wrote {path}")
