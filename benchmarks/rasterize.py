"""Milliseconds a frame of the CPU rasterizer, by stage, against its peers and its limit.

    python benchmarks/rasterize.py [--prototype FOLDER] [--heads A.ply B.ply]

Scenes are head-like: a shell of flat splats, strands of needles, a haze of floaters, SH degree
3. Wall is the median on all cores; CPU is the median processor time on one thread, which other
programs disturb less. ``pixel threads`` is the same picture by one thread a pixel in Warp's own
language. The limit is what blending would cost if every vector lane met a pixel it changes,
at the speed measured on splats that cover the whole picture; ``useful`` is the share of the
blending stage that this is. ``--prototype`` names a folder with an earlier implementation, whose
frames are drawn in turn with ours and whose CPU time is of all its threads; it draws no depth,
keeps its picture and prepares its scene beforehand. ``--heads`` adds a 120-frame turntable of
the union of two real splats.
"""

import argparse
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


def portrait(size: int) -> Camera:
    """A camera that the head fills to 70 %."""
    around = Bounds(np.zeros(3), 0.68)
    return orbit(around, [23], elevation=6, width=size, height=size, fov=27)[0]


def measure(*draws: Callable[[], object], repeats: int = 15) -> list[tuple[float, float]]:
    """Median wall and processor time of each, ms, drawn in turn, after two rounds to warm up."""
    wall = np.zeros((repeats + 2, len(draws)))
    cpu = np.zeros_like(wall)
    for i in range(repeats + 2):
        for j, draw in enumerate(draws):
            started = time.perf_counter(), time.process_time()
            draw()
            wall[i, j] = time.perf_counter() - started[0]
            cpu[i, j] = time.process_time() - started[1]
    return list(zip(*(1e3 * np.median(ms[2:], axis=0) for ms in (wall, cpu)), strict=True))


def view_of(camera: Camera) -> View:
    return views.view_of(camera.viewmat, camera.K, (camera.width, camera.height), (0.01, 1e10))


def nanoseconds_a_pair() -> float:
    """What blending one splat into one pixel costs when no lane is wasted."""
    n, size = 400, 512
    scene = head(n)
    scene["means"][:] *= 0.1
    scene["scales"][:] = 5.0
    scene["opacities"][:] = 0.006
    camera = portrait(size)
    [(_, cpu)] = measure(lambda: rasterize(**scene, **vars(camera), threads=1), repeats=5)
    return 1e6 * cpu * native.stage_shares()["blend"] / (n * size * size)


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
        counts, _, _ = portable.render(scene, 3, [view_of(camera)], np.zeros(3), "cpu")
    finally:
        kernels.blend = blend
    return float(counts[..., 0].sum(dtype=np.float64))


def prototype_of(folder: Path) -> Callable[[Scene, Camera], Callable[[], object]]:
    """What draws a scene with the earlier implementation, which prepares it first."""
    sys.path.insert(0, str(folder))
    flags = wp.config.cpu_compiler_flags
    import v2

    tiles = v2.mk2(16, 64)
    wp.config.cpu_compiler_flags = flags

    def prepare(scene: Scene, camera: Camera) -> Callable[[], object]:
        harmonics = scene["sh"].transpose(0, 2, 1)
        renderer = v2.R2(
            {
                "xyz": scene["means"],
                "q": scene["quats"],
                "ls": np.log(scene["scales"]),
                "op": np.log(scene["opacities"] / (1 - scene["opacities"] + 1e-9)),
                "dc": harmonics[..., 0],
                "rest": harmonics[..., 1:],
            },
            tiles,
        )
        view = {
            "V": camera.viewmat,
            "C": camera.position,
            "W": camera.width,
            "H": camera.height,
            "fx": camera.K[0, 0],
            "fy": camera.K[1, 1],
            "cx": camera.K[0, 2],
            "cy": camera.K[1, 2],
        }
        return lambda: renderer(view)

    return prepare


def row(
    scene: Scene, camera: Camera, pair: float, earlier: list[Callable[[], object]]
) -> list[str]:
    view = vars(camera)
    (_, slow), (wall, _), *others, (_, cpu) = measure(
        lambda: portable.render(scene, 3, [view_of(camera)], np.zeros(3), "cpu"), repeats=1
    ) + measure(
        lambda: rasterize(**scene, **view), *earlier, lambda: rasterize(**scene, **view, threads=1)
    )
    shares = native.stage_shares()
    useful = 1e-6 * pair * useful_pairs(scene, camera) / (cpu * shares["blend"])
    cells = [f"{len(scene['means'])}", f"{camera.width}", f"{wall:.1f}", f"{cpu:.1f}"]
    cells += [*(f"{cpu * s:.2f}" for s in shares.values()), f"{useful:.0%}", f"{slow:.0f}"]
    return cells + [f"{ms:.1f}" for other in others for ms in other]


def table(counts: list[int], prototype: Path | None) -> None:
    pair = nanoseconds_a_pair()
    print(f"blending without a wasted lane: {pair:.3f} ns a pair (one thread)\n")
    titles = ["splats", "size", "wall", "CPU", *native.STAGES, "useful", "pixel threads"]
    print("  ".join(titles + ["earlier wall", "earlier CPU"] * bool(prototype)))
    earlier = prototype_of(prototype) if prototype else None
    for n in counts:
        scene = head(n)
        for size in (512, 1024):
            camera = portrait(size)
            others = [earlier(scene, camera)] if earlier else []
            cells = row(scene, camera, pair, others)
            print("  ".join(f"{cell:>6}" for cell in cells), flush=True)


def twin() -> None:
    """The float64 reference on a scene small enough for it, and the difference."""
    scene = head(2000)
    camera = portrait(96)
    started = time.perf_counter()
    wanted = rasterize_reference(**scene, **vars(camera))
    seconds = time.perf_counter() - started
    [(wall, _)] = measure(lambda: rasterize(**scene, **vars(camera)))
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
    parser.add_argument("--prototype", type=Path)
    parser.add_argument("--heads", type=Path, nargs="*")
    options = parser.parse_args()
    started = time.perf_counter()
    native.PROGRAM.available()
    print(f"kernels ready in {time.perf_counter() - started:.2f} s, {cores()} cores")
    twin()
    if options.heads:
        turntable(options.heads)
    if options.counts:
        table(options.counts, options.prototype)


if __name__ == "__main__":
    main()
