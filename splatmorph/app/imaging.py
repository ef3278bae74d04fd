"""What ``splatmorph image`` does, and says of it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from renderer import write_image, write_video
from splatmorph.app import console
from splatmorph.app.render import STILLS, WITH_ALPHA
from splatmorph.errors import OptionError
from splatmorph.fitting import FitConfig, FitReport, fit
from splatmorph.flows import Linear, make_flow
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
from splatmorph.images.faces import detect_face
from splatmorph.images.folding import least_area
from splatmorph.images.generative import DiffusersAutoencoder, LatentBlend
from splatmorph.images.refine import refined
from splatmorph.landmarks import Landmarks
from splatmorph.runs.standing import standing

if TYPE_CHECKING:
    from splatmorph.app.image import Mixing, Pairing, Warping

FOUND = ("auto", "optical-flow", "face")

Pair = tuple[Landmarks, Landmarks]


def blend_of(mixing: Mixing) -> Blend:
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


def warp_of(
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
        return DelaunayWarp(*pair, canvases[0], pair[0].similarity_to(pair[1])), pair, None
    warp, report = _fitted(pair, canvases[0], warping, seed)
    if warping.refine:
        given = len(pair[0])
        pair = refined(*pictures, warp, pair)
        more = len(pair[0]) - given
        console.say(f"added {more} points that optical flow brings together half way")
        warp, report = _fitted(pair, canvases[0], warping, seed)
    return warp, pair, report


def _fitted(pair: Pair, canvas: Canvas, warping: Warping, seed: int) -> tuple[FlowWarp, FitReport]:
    torch.manual_seed(seed)
    options = {"field": warping.field} if warping.field else {}
    flow = make_flow(warping.warp, dim=2, **options)
    frame = pair[0].similarity_to(pair[1])
    ends = pair[0], pair[1].moved(frame.inverse())
    with console.fitting() as on_step:
        config = FitConfig(seed=seed, smoothing=warping.smoothing)
        report = fit(flow, *ends, config, domain=_domain(canvas), on_step=on_step)
    return FlowWarp(flow, frame), report


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


def write_morph(morph: ImageMorph, path: Path, times: list[float], fps: float) -> Path:
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


def say_standing(frame: Similarity, points: torch.Tensor, pixel: float) -> None:
    in_pixels = Similarity(frame.rotation, frame.scale, frame.shift / pixel)
    if said := standing(in_pixels, points / pixel):
        console.say(f"{said} (pixels)")


def described(morph: ImageMorph, report: FitReport | None, written: list[Path]) -> dict[str, Any]:
    """What is to say of a morph, in JSON's types."""
    canvas, warp = morph.output, morph.warp
    area = least_area(warp)
    return {
        "written": [str(path) for path in written],
        "size": [canvas.width, canvas.height],
        "fit": report.to_dict() if report else None,
        "warp_error_pixels": warp.lattice(canvas)[1] if isinstance(warp, FlowWarp) else None,
        "area_min": area.least,
        "folded": area.folded,
    }


def summarise(morph: ImageMorph, report: FitReport | None, measured: dict[str, Any]) -> None:
    canvas, error = morph.output, measured["warp_error_pixels"]
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
    if measured["folded"]:
        console.warn(f"the warp folds over {measured['folded']:.1%} of the picture")
    for path in measured["written"]:
        console.say(f"wrote {path}")
