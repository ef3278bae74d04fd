"""``splatmorph streamlines``: Draw the flow of a run."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.options import Out, Overwrite, RunPath, Size, SizeOption, UpOption
from splatmorph.errors import OptionError

if TYPE_CHECKING:
    from splatmorph.view.subject import Subject

STILLS = (".png", ".jpg")
VIDEOS = (".mp4", ".gif")
PANEL = Size(720, 720)


def streamlines(
    run: RunPath,
    /,
    *,
    out: Out = None,
    compare: Annotated[
        tuple[str, ...],
        Parameter(
            help="Fit these flows to the run's landmarks and draw them side by side: "
            "node,ncf,ifmorph."
        ),
    ] = (),
    colour: Annotated[str, Parameter(help="What colours the lines: speed, or det.")] = "speed",
    seeds: Annotated[int, Parameter(help="Lines from the surface, beside the landmarks'.")] = 240,
    azimuth: Annotated[
        float, Parameter(help="Degrees from the front.", allow_leading_hyphen=True)
    ] = 30.0,
    elevation: Annotated[
        float, Parameter(help="Degrees above the object.", allow_leading_hyphen=True)
    ] = 10.0,
    up: UpOption = None,
    size: SizeOption = PANEL,
    frames: Annotated[int, Parameter(help="Pictures of a video.")] = 48,
    interactive: Annotated[
        bool, Parameter(negative="", help="Open a window to turn it round in.")
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Draw the velocity field of a run as streamlines through its landmarks and surface.

    Coloured from t = 0 to 1, thin and grey upstream; landmarks in teal at the source, in orange
    at the target. The extension chooses: .png, an orbit as .mp4 or .gif, .html to turn round,
    .vtp for ParaView. Without -o the picture is RUN.streamlines.png.
    """
    from renderer import orbit, write_image, write_video
    from splatmorph.rendering import turntable, upright
    from splatmorph.view import streamlines as drawing
    from splatmorph.view.subject import open_subject

    path = out or Path(f"{run.resolve().stem}.streamlines.png")
    kind = path.suffix.lower()
    if kind not in (*STILLS, *VIDEOS, ".html", ".vtp"):
        raise OptionError(f"{path}: expected .png, .jpg, .mp4, .gif, .html or .vtp")
    if not interactive:
        console.claim(path, overwrite)
    subject, _ = open_subject(run)
    above = upright(subject.morph.source, up)
    subjects = [subject]
    if compare:
        subjects = [_refitted(subject, name) for part in compare for name in part.split(",")]
    lines = [drawing.trace(one, seeds=seeds, colouring=colour) for one in subjects]
    around = subject.bounds()
    width, height = size
    view = orbit(around, [azimuth], elevation=elevation, up=above, width=width, height=height)[0]
    if interactive:
        return drawing.show(subjects, lines, view)
    if kind == ".vtp":
        if len(lines) > 1:
            raise OptionError("--compare makes several sets of lines: write a picture, not a .vtp")
        drawing.save_lines(path, lines[0])
    elif kind == ".html":
        drawing.show(subjects, lines, view, path)
    elif kind in STILLS:
        write_image(path, drawing.picture(subjects, lines, view))
    else:
        views = turntable(around, frames, azimuth=0, elevation=elevation, up=above, size=size)
        with console.progress("drawing") as update:

            def pictures() -> Iterator[Any]:
                for i, one in enumerate(views):
                    yield drawing.picture(subjects, lines, one)
                    update(i + 1, frames, "")

            path = write_video(path, pictures(), frames / 4)
    console.say(f"wrote {path}")


def _refitted(subject: Subject, kind: str) -> Subject:
    """The same subject with another flow, fitted here; as it is where that is its own flow."""
    if kind == subject.morph.flow.kind:
        return subject
    from dataclasses import replace

    from splatmorph.fitting import fit
    from splatmorph.flows import make_flow
    from splatmorph.landmarks import Landmarks

    flow = make_flow(kind)
    names = subject.landmark_names
    with console.progress(f"fitting {kind}") as update:
        fit(
            flow,
            Landmarks(subject.source_points, names),
            Landmarks(subject.target_points, names).moved(subject.morph.frame.inverse()),
            domain=subject.morph.source.means,
            on_step=lambda progress: update(
                progress.step, progress.steps, f"error {progress.mse:.2e}"
            ),
        )
    return replace(subject, morph=replace(subject.morph, flow=flow))
