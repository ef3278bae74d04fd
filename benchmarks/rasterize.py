"""Milliseconds a frame of the CPU rasterizer, by stage, against its peers and its limit.

    python benchmarks/rasterize.py [--against CHECKOUT] [--counts N …] [--heads A.ply B.ply]

Scenes are head-like: a shell of flat splats, strands of needles, a haze of floaters, SH degree
3. Wall is the median on all cores; CPU is the median processor time on one thread, which other
programs disturb less. ``pixel threads`` is the same picture by one thread a pixel in Warp's own
language. The limit is what blending would cost if every vector lane met a pixel it changes,
at the speed measured on splats that cover the whole picture; ``useful`` is the share of the
blending stage that this is. ``--against`` names a checkout of another commit, whose frames are
drawn in turn with ours in this process: ``of its wall`` and ``of its CPU`` are medians of ours
divided by its in the same round. ``--heads`` adds a 120-frame turntable of the union of two real
splats.
"""

import argparse
import importlib
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import warp as wp
from numpy.typing import NDArray

from renderer import (
    Bounds,
    Camera,
    bounds_of,
    kernels,
    native,
    orbit,
    portable,
    rasterize,
    rasterize_reference,
    views,
    write_video,
)
from renderer.cpp import cores
from renderer.views import View

Scene = dict[str, NDArray[np.float32]]
AXES = np.array([0.38, 0.5, 0.43])


def head(n: int, seed: int = 0) -> Scene:
    """A head-like scene of n splats, one unit high."""
    rng = np.random.default_rng(seed)
    size = 0.008 * (1e5 / n) ** (1 / 3)
    strands, floaters = n // 4, 3 * n // 100
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    means = normals * AXES * (1 + 0.015 * rng.normal(size=(n, 1)))
    scales = size * np.exp(0.5 * rng.normal(size=(n, 3))) * [1, 1, 0.25]
    scales[:strands] = [0.012, 0.002, 0.002] * np.exp(0.35 * rng.normal(size=(strands, 3)))
    means[:strands] *= 1 + 0.12 * rng.random((strands, 1))
    means[-floaters:] = rng.uniform(-0.45, 0.45, (floaters, 3))
    logits = np.where(rng.random(n) < 0.75, rng.normal(2.5, 1.5, n), rng.normal(-1.5, 1, n))
    logits[-floaters:] = rng.normal(-2.5, 1, floaters)
    # The shortest arc from +z to the normal lays a splat on the surface.
    quats = np.column_stack([1 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(n)])
    quats[:strands] = rng.normal(size=(strands, 4))
    sh = np.concatenate([rng.normal(0.3, 0.6, (n, 1, 3)), rng.normal(0, 0.04, (n, 15, 3))], 1)
    scene = {
        "means": means,
        "quats": quats,
        "scales": scales,
        "opacities": 1 / (1 + np.exp(-logits)),
        "sh": sh,
    }
    order = rng.permutation(n)
    return {name: np.ascontiguousarray(a[order], np.float32) for name, a in scene.items()}


def portrait(width: int, height: int) -> Camera:
    """A camera of whose height the head fills 70 %."""
    around = Bounds(np.zeros(3), 0.68)
    return orbit(around, [23], elevation=6, width=width, height=height, fov=27)[0]


Times = NDArray[np.float64]


def measure(*draws: Callable[[], object], repeats: int = 15) -> tuple[Times, Times]:
    """Wall and processor time, ms (repeats, draws), drawn in turn, after two rounds to warm up."""
    wall = np.zeros((repeats + 2, len(draws)))
    cpu = np.zeros_like(wall)
    for i in range(repeats + 2):
        for j, draw in enumerate(draws):
            started = time.perf_counter(), time.process_time()
            draw()
            wall[i, j] = time.perf_counter() - started[0]
            cpu[i, j] = time.process_time() - started[1]
    return 1e3 * wall[2:], 1e3 * cpu[2:]


def view_of(camera: Camera) -> View:
    return views.view_of(camera.viewmat, camera.K, (camera.width, camera.height), (0.01, 1e10))


def nanoseconds_a_pair() -> float:
    """What blending one splat into one pixel costs when no lane is wasted."""
    n, size = 400, 512
    scene = head(n)
    scene["means"][:] *= 0.1
    scene["scales"][:] = 5.0
    scene["opacities"][:] = 0.006
    camera = portrait(size, size)
    _, cpu = measure(lambda: rasterize(**scene, **vars(camera), threads=1), repeats=5)
    return 1e6 * float(np.median(cpu)) * native.stage_shares()["blend"] / (n * size * size)


@wp.kernel
def count_pairs(
    view: kernels.View,
    splats: kernels.Splats,
    starts: wp.array(dtype=int),
    stops: wp.array(dtype=int),
    ids: wp.array(dtype=int),
    sums: wp.array2d(dtype=wp.vec4),
    transmittance: wp.array2d(dtype=float),
):
    """``kernels.blend``, but what is summed is how many splats change the pixel."""
    y, x = wp.tid()
    T = float(1.0)  # noqa: UP018 (a literal would be a constant to Warp)
    tile = (y // kernels.TILE) * view.columns + x // kernels.TILE
    for at in range(starts[tile], stops[tile]):
        i = ids[at]
        d = wp.vec2(float(x) + 0.5, float(y) + 0.5) - splats.center[i]
        conic = splats.conic[i]
        falloff = 0.5 * (conic[0] * d[0] * d[0] + conic[2] * d[1] * d[1]) + conic[1] * d[0] * d[1]
        power = splats.log_opacity[i] - falloff
        if power >= kernels.LOG_ALPHA_MIN:
            T *= 1.0 - wp.min(wp.exp(power), kernels.ALPHA_MAX)
            if T < kernels.TRANSMITTANCE_MIN:
                break
            sums[y, x] += wp.vec4(1.0, 0.0, 0.0, 0.0)


def useful_pairs(scene: Scene, camera: Camera) -> float:
    """How many (splat, pixel) pairs change a pixel."""
    blend, kernels.blend = kernels.blend, count_pairs
    try:
        counts, _, _ = portable.render(scene, 3, [view_of(camera)], np.zeros(3), 0.0, "cpu")
    finally:
        kernels.blend = blend
    return float(counts[..., 0].sum(dtype=np.float64))


def renderer_of(checkout: Path) -> Callable[..., object]:
    """``rasterize`` of another checkout, compiled, beside ours."""
    ours = {
        name: sys.modules.pop(name) for name in [*sys.modules] if name.split(".")[0] == "renderer"
    }
    sys.path.insert(0, str(checkout.resolve()))
    try:
        theirs = importlib.import_module("renderer")
        if not importlib.import_module("renderer.native").PROGRAM.available():
            raise SystemExit(f"the renderer of {checkout} doesn't compile here")
    finally:
        sys.path.pop(0)
        for name in [name for name in sys.modules if name.split(".")[0] == "renderer"]:
            del sys.modules[name]
        sys.modules.update(ours)
    return theirs.rasterize


def row(
    scene: Scene, camera: Camera, pair: float, theirs: Callable[..., object] | None
) -> list[str]:
    view = {**scene, **vars(camera)}
    slow = measure(
        lambda: portable.render(scene, 3, [view_of(camera)], np.zeros(3), 0.0, "cpu"), repeats=1
    )[1].item()
    draws = [lambda: rasterize(**view), lambda: rasterize(**view, threads=1)]
    if theirs:
        draws = [lambda: theirs(**view), lambda: theirs(**view, threads=1), *draws]
    walls, cpus = measure(*draws)
    wall, cpu = np.median(walls[:, -2]), np.median(cpus[:, -1])
    shares = native.stage_shares()
    useful = 1e-6 * pair * useful_pairs(scene, camera) / (cpu * shares["blend"])
    cells = [f"{len(scene['means'])}", f"{camera.width}x{camera.height}"]
    cells += [f"{wall:.1f}", f"{cpu:.1f}", *(f"{cpu * s:.2f}" for s in shares.values())]
    cells += [f"{useful:.0%}", f"{slow:.0f}"]
    if theirs:
        of_wall, of_cpu = walls[:, 2] / walls[:, 0], cpus[:, 3] / cpus[:, 1]
        cells += [f"{np.median(of_wall):.2f}", f"{np.median(of_cpu):.2f}"]
    return cells


def table(counts: list[int], against: Path | None) -> None:
    pair = nanoseconds_a_pair()
    print(f"blending without a wasted lane: {pair:.3f} ns a pair (one thread)\n")
    titles = ["splats", "size", "wall", "CPU", *native.STAGES, "useful", "pixel threads"]
    print("  ".join(titles + ["of its wall", "of its CPU"] * bool(against)))
    theirs = renderer_of(against) if against else None
    for n in counts:
        scene = head(n)
        for width, height in ((512, 512), (1920, 1080)):
            cells = row(scene, portrait(width, height), pair, theirs)
            print("  ".join(f"{cell:>6}" for cell in cells), flush=True)


def twin() -> None:
    """The float64 reference on a scene small enough for it, and the difference."""
    scene = head(2000)
    camera = portrait(96, 96)
    started = time.perf_counter()
    wanted = rasterize_reference(**scene, **vars(camera))
    seconds = time.perf_counter() - started
    wall = np.median(measure(lambda: rasterize(**scene, **vars(camera)))[0])
    error = np.abs(rasterize(**scene, **vars(camera))[0] - wanted[0])
    print(f"2000 splats, 96x96: reference {seconds:.1f} s, ours {wall:.2f} ms, ", end="")
    print(f"max difference {error.max():.1e}, pixels above 1e-3: {(error > 1e-3).any(-1).sum()}")


def turntable(paths: list[Path]) -> None:
    """120 frames of 512x512 of all the splats together, to mp4."""
    from splatmorph import io
    from splatmorph.gaussians import Gaussians
    from splatmorph.rendering import renderer_arrays

    both = io.read(paths[0])
    for path in paths[1:]:
        both = Gaussians.union(both, io.read(path))
    arrays = renderer_arrays(both)
    bounds = bounds_of(arrays[0], arrays[3], arrays[2])
    cameras = orbit(bounds, np.arange(120) * 3.0)
    with tempfile.TemporaryDirectory() as folder:
        started = time.perf_counter()
        frames = (rasterize(*arrays, **vars(c), background=(1, 1, 1))[0] for c in cameras)
        write_video(Path(folder) / "turntable.mp4", frames)
        seconds = time.perf_counter() - started
    print(f"{len(both)} splats, 120 frames of 512x512 to mp4: {seconds:.1f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--counts", type=int, nargs="*", default=[20_000, 100_000, 300_000])
    parser.add_argument("--against", type=Path)
    parser.add_argument("--heads", type=Path, nargs="*")
    options = parser.parse_args()
    started = time.perf_counter()
    native.PROGRAM.available()
    print(f"kernels ready in {time.perf_counter() - started:.2f} s, {cores()} cores")
    twin()
    if options.heads:
        turntable(options.heads)
    if options.counts:
        table(options.counts, options.against)


if __name__ == "__main__":
    main()
