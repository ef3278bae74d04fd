"""Pictures: fit, seconds a frame against peers, the middle frame of a video, memory.

    python benchmarks/images.py DATA

DATA is the folder of real inputs; of it ``faces2d`` is used (FRLL 001 and 002). Prints Markdown.
A frame is both pictures warped, blended and turned to 8 bits. "set up" is what is done once: the
lattice, or for a peer nothing. The error is the largest distance, at 5 000 pixels, between where
a frame reads its pictures and where the flow, integrated there, leads. scikit-image is used
where it is installed.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from splatmorph.errors import MissingExtraError
from splatmorph.fitting import FitConfig, fit
from splatmorph.flows import Flow, make_flow
from splatmorph.images import (
    Canvas,
    FlowWarp,
    ImageMorph,
    Picture,
    Warp,
    read_pair,
    read_points,
    with_anchors,
)
from splatmorph.images.correspond import dense_motion, follow_motion
from splatmorph.images.delaunay import DelaunayWarp, DenseMap
from splatmorph.images.quality import psnr
from splatmorph.images.warp import PixelMap, sample
from splatmorph.landmarks import Landmarks
from splatmorph.metrics import landmark_mse

SIZES = (256, 1350)
FRAMES = 30
CHECKED = 5000
SMOOTHING = 1e-4
FLOWS = {
    "node, spline": {"kind": "node"},
    "node, siren": {"kind": "node", "field": "siren"},
    "tps displacement": {"kind": "tps"},
}

Pair = tuple[Landmarks, Landmarks]


@dataclass(frozen=True)
class PlainWarp:
    """Every pixel of every frame integrated by itself."""

    flow: Flow

    def maps(self, canvas: Canvas, times: Sequence[float]) -> Iterator[tuple[PixelMap, PixelMap]]:
        """As ``Warp.maps``."""
        centers = canvas.centers()
        for t in times:
            both = self.flow.trajectory(centers.flatten(0, 1), [-t, 1 - t])
            source, target = both.view(2, *centers.shape)
            yield DenseMap(source), DenseMap(target)

    def carry(self, points: torch.Tensor, t: float) -> torch.Tensor:
        """As ``Warp.carry``."""
        return self.flow(points, t)


@dataclass(frozen=True)
class ScikitWarp:
    """The thin-plate spline of scikit-image, fitted anew for every frame as its users do."""

    pair: Pair

    def maps(self, canvas: Canvas, times: Sequence[float]) -> Iterator[tuple[PixelMap, PixelMap]]:
        """As ``Warp.maps``."""
        from skimage.transform import ThinPlateSplineTransform

        p, q, _ = (np.asarray(side) for side in self.pair[0].match(self.pair[1]))
        centers = canvas.centers()
        for t in times:
            sides = []
            for side in (p, q):
                spline = ThinPlateSplineTransform.from_estimate((1 - t) * p + t * q, side)
                # It holds a number for every pixel and landmark: a row at a time.
                rows = [spline(row.numpy().astype(np.float64)) for row in centers]
                sides.append(DenseMap(torch.from_numpy(np.stack(rows)).float()))
            yield sides[0], sides[1]

    def carry(self, points: torch.Tensor, t: float) -> torch.Tensor:
        """Not asked for here."""
        raise NotImplementedError


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    faces = parser.parse_args().data / "faces2d"
    pictures = (Picture.read(faces / "001_03.jpg"), Picture.read(faces / "002_03.jpg"))
    canvases = (pictures[0].canvas, pictures[1].canvas)
    template = tuple(
        read_points(faces / f"{name}_03.tem", canvas)
        for name, canvas in zip(("001", "002"), canvases, strict=True)
    )
    manual = read_pair(faces / "flowing_manual_landmarks_001_002.json", *canvases)
    assert manual is not None
    print(f"{torch.get_num_threads()} threads\n")
    compare_fits({"189 template": (template[0], template[1]), "130 manual": manual}, canvases)
    pair = with_anchors(*manual, canvases, 2)
    compare_frames(pictures, pair)
    compare_middle_frames(pictures[0])
    measure_memory(pictures, pair)


def compare_fits(pairs: dict[str, Pair], canvases: tuple[Canvas, Canvas]) -> None:
    """Landmark errors over the points as given, folding, seconds."""
    print("| landmarks | flow | fit s | MSE before | MSE | least det, 256² |")
    print("|---|---|---|---|---|---|")
    for name, given in pairs.items():
        for kind, options in FLOWS.items():
            flow = make_flow(dim=2, **options)
            anchored = with_anchors(*given, canvases, 2)
            report = fit(flow, *anchored, FitConfig(smoothing=SMOOTHING))
            p, q = (side.points for side in given)
            before = float((p - q).square().mean())
            print(
                f"| {name} | {kind} | {report.seconds:.3f} | {before:.1e} | "
                f"{landmark_mse(flow, p, q):.1e} | {least_area(flow):.2f} |"
            )
    print()


def least_area(flow: Flow) -> float:
    """The least determinant of the warps to either end on 256² pixels, by differences."""
    canvas = Canvas(256, 256)
    least = []
    for source, target in PlainWarp(flow).maps(canvas, [1.0, 0.0]):
        for where in (source.band(0, 256), target.band(0, 256)):
            right = (where[:-1, 1:] - where[:-1, :-1]) / canvas.pixel
            down = (where[1:, :-1] - where[:-1, :-1]) / canvas.pixel
            least.append((right[..., 1] * down[..., 0] - right[..., 0] * down[..., 1]).min())
    return float(min(least))


def compare_frames(pictures: tuple[Picture, Picture], pair: Pair) -> None:
    """Seconds a frame, each way of warping at each size."""
    flows = {}
    for name, options in FLOWS.items():
        flows[name] = make_flow(dim=2, **options)
        fit(flows[name], *pair, FitConfig(smoothing=SMOOTHING))
    plain = "node, spline, every pixel integrated"
    warps: dict[str, Callable[[], Warp]] = {
        **{name: lambda flow=flow: FlowWarp(flow) for name, flow in flows.items()},
        plain: lambda: PlainWarp(flows["node, spline"]),
        "Delaunay, OpenCV's way": lambda: DelaunayWarp(*pair, pictures[0].canvas),
        "scikit-image TPS": lambda: ScikitWarp(pair),
    }
    print(f"| warp | size | set up s | s a frame of {FRAMES} | s, one frame | error, pixels |")
    print("|---|---|---|---|---|---|")
    for name, make in warps.items():
        for size in SIZES:
            canvas = Canvas(size, size)
            morph = ImageMorph(*pictures, make(), canvas)
            begun = time.perf_counter()
            try:
                morph.at(0.5)
            except ImportError:
                print(f"| {name} | {size}² | not installed | | | |")
                continue
            first = time.perf_counter() - begun
            dear = name == plain or isinstance(morph.warp, ScikitWarp)
            once = median(lambda morph=morph: morph.at(0.5).eight_bit(), 1 if dear else 5)
            count = 1 if dear else FRAMES
            times = [(i + 0.5) / count for i in range(count)]
            begun = time.perf_counter()
            for frame in morph.sequence(times):
                frame.eight_bit()
            each = (time.perf_counter() - begun) / count
            error = reading_error(morph.warp, canvas)
            print(
                f"| {name} | {size}² | {max(0, first - once):.2f} | {each:.3f} | {once:.3f} "
                f"| {error} |"
            )
    print()


def reading_error(warp: Warp, canvas: Canvas) -> str:
    """How far a flow's frame reads from where the flow leads, in pixels."""
    if not isinstance(warp, FlowWarp):
        return ""
    generator = torch.Generator().manual_seed(1)
    chosen = torch.randint(canvas.width * canvas.height, (CHECKED,), generator=generator)
    centers = canvas.centers().flatten(0, 1)[chosen].double()
    missed = []
    for t in (0.25, 0.5, 1.0):
        exact = warp.flow.trajectory(centers, [-t, 1 - t])
        maps = next(warp.maps(canvas, [t]))
        found = torch.stack([m.band(0, canvas.height).flatten(0, 1)[chosen] for m in maps])
        missed.append((found - exact).norm(dim=-1).max())
    return f"{float(max(missed)) / canvas.pixel:.3f}"


def compare_middle_frames(picture: Picture) -> None:
    """The middle of three frames of a known smooth motion, from the outer two."""
    size = 675
    canvas = Canvas(size, size)
    generator = torch.Generator().manual_seed(2)
    start = torch.rand(12, 2, generator=generator, dtype=torch.float64) * 1.6 - 0.8
    drift = torch.randn(12, 2, generator=generator, dtype=torch.float64) * 0.02
    motion = make_flow("node", dim=2)
    fit(motion, Landmarks(start), Landmarks(start + drift))
    planes = picture.planes(canvas)
    first, middle, last = (
        Picture(Picture.from_planes(sample(planes, canvas, where, canvas, "bicubic")).eight_bit())
        for where, _ in FlowWarp(motion).maps(canvas, [0.0, 0.5, 1.0])
    )
    print("| middle frame | PSNR, dB | MSE |")
    print("|---|---|---|")
    try:
        guesses = guessed_middles(first, last)
    except MissingExtraError as error:
        print(f"| {error} | | |\n")
        return
    for name, guess in guesses.items():
        inner = slice(32, -32)
        truth, found = (
            torch.from_numpy(p.as_float().pixels[inner, inner]) for p in (middle, guess)
        )
        mse = float((truth - found).square().mean())
        print(f"| {name} | {psnr(truth, found):.1f} | {mse:.1e} |")
    print()


def guessed_middles(first: Picture, last: Picture) -> dict[str, Picture]:
    """The middle frame by each method."""
    flow = make_flow("node", dim=2)
    fit(flow, *follow_motion(first, last), FitConfig(smoothing=SMOOTHING))
    return {
        "linear blend": ImageMorph(first, last, FlowWarp(make_flow("linear", dim=2))).at(0.5),
        "dense optical flow (DIS), halved": ImageMorph(first, last, DenseFlow(first, last)).at(0.5),
        "node, spline, on a sparse sample of it": ImageMorph(first, last, FlowWarp(flow)).at(0.5),
    }


@dataclass(frozen=True)
class DenseFlow:
    """Both frames warped by a share of the dense optical flow, as is usual."""

    first: Picture
    last: Picture

    def maps(self, canvas: Canvas, times: Sequence[float]) -> Iterator[tuple[PixelMap, PixelMap]]:
        """As ``Warp.maps``."""
        step = torch.tensor([canvas.pixel, -canvas.pixel])
        motion = torch.from_numpy(dense_motion(self.first, self.last)).float() * step
        centers = canvas.centers()
        for t in times:
            yield DenseMap(centers - t * motion), DenseMap(centers + (1 - t) * motion)

    def carry(self, points: torch.Tensor, t: float) -> torch.Tensor:
        """Not asked for here."""
        raise NotImplementedError


def measure_memory(pictures: tuple[Picture, Picture], pair: Pair) -> None:
    """The peak of a 4000 × 4000 frame, everything included."""
    large = Canvas(4000, 4000)
    flow = make_flow("node", dim=2)
    fit(flow, *pair, FitConfig(smoothing=SMOOTHING))
    enlarged = [
        ImageMorph(one, one, FlowWarp(make_flow("linear", dim=2)), large).at(0.5).eight_bit()
        for one in pictures
    ]
    begun = time.perf_counter()
    ImageMorph(*map(Picture, enlarged), FlowWarp(flow)).at(0.5).eight_bit()
    seconds = time.perf_counter() - begun
    unit = 2**30 if sys.platform == "darwin" else 2**20
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
    print(f"4000 × 4000 from 4000 × 4000: {seconds:.2f} s with set-up, process peak {peak:.2f} GB")


def median(action: Callable[[], object], repeats: int = 5) -> float:
    """Median wall time of ``action``."""
    taken = []
    for _ in range(repeats):
        begun = time.perf_counter()
        action()
        taken.append(time.perf_counter() - begun)
    return statistics.median(taken)


if __name__ == "__main__":
    main()
