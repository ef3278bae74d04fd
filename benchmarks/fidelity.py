"""What covariance modes and ramps are worth, against warps whose answer is known.

    python benchmarks/fidelity.py HEAD.ply…            all tables
    python benchmarks/fidelity.py HEAD.ply --only self  one of: warp, shading, self, split, cost

warp     the head is warped by a known smooth flow with its exact push-forward, to make B; a flow
         is fitted to 250 landmarks of the pair; the source half at t = 1 is compared with B and
         the morph at t = 1/2 with the head warped half way, over eight views: PSNR / SSIM
shading  the twist on the head with a strong view-dependent lobe (SH degree 3) that turns with
         the surface or does not
self     the head morphed into itself, nine frames: the worst and the middle PSNR a ramp
split    the head, as it is and with stretched splats split, pushed exactly by the warps at one
         and two times their strength, against smaller splats pushed exactly; and how far the
         split head is from the head before any warp
cost     seconds for 120 frames of the first head morphed into the last, one half each
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from renderer import Bounds, Camera, orbit, rasterize
from splatmorph import io
from splatmorph.fitting import fit
from splatmorph.flows import Flow, make_flow
from splatmorph.flows.base import Times, as_floats
from splatmorph.gaussians import FAINTEST_DRAWN, Gaussians
from splatmorph.geometry.harmonics import harmonics, rotate_sh
from splatmorph.geometry.quaternions import from_matrices
from splatmorph.images.quality import psnr, ssim
from splatmorph.landmarks import Landmarks
from splatmorph.morph import Morph
from splatmorph.morph.ramps import RAMPS
from splatmorph.morph.splitting import split, split_stretched
from splatmorph.morph.transport import COVARIANCES
from splatmorph.rendering import bounds, renderer_arrays

LANDMARKS = 250
SIZE = 512
AZIMUTHS = np.linspace(-45, 45, 8).tolist()

THRESHOLDS = (2.0, 1.5)
"""Stretches from which splats are split."""

COMPARED = ("linear", "calibrated")
"""The ramps that the warps are tried with."""

Velocity = Callable[[Tensor], Tensor]


def known_warps(center: Tensor, radius: float) -> dict[str, Velocity]:
    """Velocities at one point (3,) of flows that are known exactly; y is up, z to the front."""
    nose = center + torch.tensor([0, 0, 0.3 * radius], dtype=center.dtype)

    def swelling(x: Tensor) -> Tensor:
        d = x - nose
        return 0.8 * torch.exp(-0.5 * d.square().sum() / (0.35 * radius) ** 2) * d

    def twist(x: Tensor) -> Tensor:
        # 60° from chin to crown, which are about 1.2 radii apart.
        d = x - center
        rate = math.radians(60) / (1.2 * radius) * d[1]
        return rate * torch.stack([d[2], 0 * d[1], -d[0]])

    def shear(x: Tensor) -> Tensor:
        d = x - center
        return torch.stack([0.5 * d[1], 0 * d[1], 0 * d[1]])

    def bend(x: Tensor) -> Tensor:
        d = x - center
        return torch.stack([0 * d[1], 0 * d[1], -0.8 / radius * d[1] ** 2])

    return {"swelling": swelling, "twist 60°": twist, "shear": shear, "bend": bend}


def travelled(velocity: Velocity, x: Tensor, t: float, steps: int = 32) -> tuple[Tensor, Tensor]:
    """Φ(x, t) and its Jacobian, by Runge-Kutta and automatic differentiation in float64."""

    def path(point: Tensor) -> Tensor:
        h = t / steps
        for _ in range(steps):
            k1 = velocity(point)
            k2 = velocity(point + 0.5 * h * k1)
            k3 = velocity(point + 0.5 * h * k2)
            k4 = velocity(point + h * k3)
            point = point + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return point

    return torch.vmap(path)(x), torch.vmap(torch.func.jacfwd(path))(x)


def truly_warped(gaussians: Gaussians, velocity: Velocity, t: float) -> Gaussians:
    """The splat pushed forward exactly, by singular value decompositions in float64."""
    means, jacobians = travelled(velocity, gaussians.means.double(), t)
    u, _, vh = torch.linalg.svd(jacobians)
    turns = u @ vh
    w, x, y, z = torch.nn.functional.normalize(gaussians.quats.double(), dim=1).unbind(1)
    axes = torch.stack(
        [
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], 1),
            torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], 1),
            torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1),
        ],
        dim=1,
    )
    pushed, scales, _ = torch.linalg.svd(jacobians @ axes * gaussians.scales.double()[:, None])
    pushed = pushed * torch.linalg.det(pushed)[:, None, None]
    return replace(
        gaussians,
        means=means.float(),
        quats=from_matrices(pushed).float(),
        log_scales=scales.clamp_min(1e-12).log().float(),
        sh=rotate_sh(gaussians.sh, turns),
    )


class KnownFlow(Flow):
    """A known warp as the flow that it is, in the few steps that finding stretches needs."""

    def __init__(self, velocity: Velocity, strength: float) -> None:
        super().__init__(3)
        self.known = velocity
        self.strength = strength

    def trajectory_jacobian(self, x: Tensor, times: Times) -> tuple[Tensor, Tensor]:
        found = [
            travelled(self.known, x.double(), self.strength * t, steps=4) for t in as_floats(times)
        ]
        path, jacobians = (torch.stack(each).to(x) for each in zip(*found, strict=True))
        return path, jacobians


def fitted(source: Gaussians, target: Gaussians, around: Bounds) -> Flow:
    """A flow fitted to some splats that both have, as landmarks."""
    center = torch.from_numpy(around.center).float()
    inside = (source.means - center).norm(dim=1) < 1.2 * around.radius
    solid = (inside & (source.opacities > 0.3)).nonzero().flatten()
    chosen = solid[spread(source.means[solid], LANDMARKS)]
    names = tuple(map(str, chosen.tolist()))
    flow = make_flow("node", 3)
    fit(flow, Landmarks(source.means[chosen], names), Landmarks(target.means[chosen], names))
    return flow


def spread(points: Tensor, count: int) -> Tensor:
    """Indices of ``count`` points spread evenly: each the farthest from those before."""
    chosen = [0]
    distance = (points - points[0]).norm(dim=1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = torch.minimum(distance, (points - points[chosen[-1]]).norm(dim=1))
    return torch.tensor(chosen)


def views(around: Bounds) -> list[Camera]:
    """Eight cameras round the front."""
    return orbit(around, AZIMUTHS, elevation=5, width=SIZE, height=SIZE)


def pictures(gaussians: Gaussians, cameras: Sequence[Camera]) -> list[NDArray[np.float32]]:
    """The splat on white from each camera."""
    arrays = renderer_arrays(gaussians)
    return [
        rasterize(*arrays, c.viewmat, c.K, SIZE, SIZE, background=(1.0, 1.0, 1.0))[0]
        for c in cameras
    ]


def score(found: Sequence[NDArray[np.float32]], true: Sequence[NDArray[np.float32]]) -> str:
    """Mean PSNR / SSIM over views."""
    pairs = [(torch.from_numpy(a), torch.from_numpy(b)) for a, b in zip(found, true, strict=True)]
    db = [psnr(a, b) for a, b in pairs]
    return f"{np.mean(db):.1f} / {np.mean([ssim(a, b) for a, b in pairs]):.3f}"


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a markdown table, row by row as they come."""
    print(f"\n{title}\n\n| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
    for row in rows:
        print(f"| {' | '.join(row)} |", flush=True)


def warp_table(name: str, head: Gaussians) -> None:
    """Every known warp, every covariance mode and ramp."""
    table(
        f"{name}: PSNR in dB / SSIM, mean of eight views",
        ["warp", "covariance", "source half at t = 1", *(f"t = 1/2, {ramp}" for ramp in COMPARED)],
        warp_rows(head),
    )


def warp_rows(head: Gaussians) -> Iterator[list[str]]:
    """The rows of ``warp_table``."""
    around = bounds(head)
    center = torch.from_numpy(around.center).double()
    for warp, velocity in known_warps(center, around.radius).items():
        target, halfway = (truly_warped(head, velocity, t) for t in (1.0, 0.5))
        cameras = views(bounds(head, target))
        true_end, true_half = pictures(target, cameras), pictures(halfway, cameras)
        flow = fitted(head, target, around)
        for covariance in COVARIANCES:
            carried = COVARIANCES[covariance](head, flow, [1.0])(0)
            row = [warp, covariance, score(pictures(carried, cameras), true_end)]
            for ramp in COMPARED:
                morph = Morph(head, target, flow, blend="union", covariance=covariance, ramp=ramp)
                row.append(score(pictures(morph.at(0.5), cameras), true_half))
            yield row


def glossy(head: Gaussians, around: Bounds, strength: float = 0.6) -> Gaussians:
    """The head with a lobe of degree 3 round the direction away from its center line."""
    outward = head.means.double() - torch.from_numpy(around.center).double()
    outward[:, 1] = 0
    seen_along = -torch.nn.functional.normalize(outward, dim=1)
    bands = [harmonics(seen_along, order)[..., None].expand(-1, -1, 3) for order in (1, 2, 3)]
    return replace(head, sh=torch.cat([head.sh[:, :1], strength * torch.cat(bands, 1).float()], 1))


def shading_table(name: str, head: Gaussians) -> None:
    """The twist on a scene with strong view dependence, its colours turned or not."""
    around = bounds(head)
    shiny = glossy(head, around)
    velocity = known_warps(torch.from_numpy(around.center).double(), around.radius)["twist 60°"]
    target = truly_warped(shiny, velocity, 1.0)
    cameras = views(bounds(head, target))
    true_end = pictures(target, cameras)
    flow = fitted(shiny, target, around)
    rows = []
    for covariance in ("rotate", "full"):
        carried = COVARIANCES[covariance](shiny, flow, [1.0])(0)
        on, off = (pictures(g, cameras) for g in (carried, replace(carried, sh=shiny.sh)))
        rows.append([covariance, score(on, true_end), score(off, true_end)])
    table(
        f"{name}, glossy, twisted by 60°: source half at t = 1",
        ["covariance", "colours turned", "colours as they were"],
        rows,
    )


def self_table(name: str, head: Gaussians) -> None:
    """Nine frames of the head morphed into itself (a flow that moves nothing)."""
    cameras = views(bounds(head))[1::3]
    alone = pictures(head, cameras)
    rows = []
    for ramp, fade in RAMPS.items():
        values = []
        for i in range(1, 5):
            both = Gaussians.union(fade(head, 1 - i / 8), fade(head, i / 8))
            pairs = zip(pictures(both, cameras), alone, strict=True)
            values.append([psnr(*map(torch.from_numpy, pair)) for pair in pairs])
        rows.append([ramp, *(f"{min(row):.1f}" for row in values)])
    table(
        f"{name} morphed into itself: the worst PSNR in dB of {len(cameras)} views",
        ["ramp", *(f"t = {i}/8" for i in range(1, 5))],
        rows,
    )


def split_table(name: str, head: Gaussians) -> None:
    """Stretched splats split or not, against smaller ones."""
    table(
        f"{name}: PSNR in dB / SSIM against smaller splats, mean of four views",
        ["warp", "strength", "split beyond", "splats", "at t = 0", "full", "fixed"],
        split_rows(head.select(head.opacities >= FAINTEST_DRAWN)),
    )


def split_rows(head: Gaussians) -> Iterator[list[str]]:
    """The rows of ``split_table``."""
    around = bounds(head)
    finest = split_longest(split_longest(head))
    alone = views(around)[::2]
    at_rest = pictures(head, alone)
    smallest = score(pictures(finest, alone), at_rest)
    yield ["", "0", "the smaller ones", str(len(finest)), smallest, "", ""]
    center = torch.from_numpy(around.center).double()
    warps = known_warps(center, around.radius)
    # A linear flow carries splats of any size exactly.
    del warps["shear"]
    for (warp, velocity), strength in product(warps.items(), (1.0, 2.0)):
        cameras = views(bounds(truly_warped(head, velocity, strength)))[::2]
        true_end = pictures(truly_warped(finest, velocity, strength), cameras)
        for threshold in (None, *THRESHOLDS):
            parts, takeover = head, "same"
            if threshold:
                parts = split_stretched(head, KnownFlow(velocity, strength), 1, threshold)
            if len(parts) > len(head):
                takeover = score(pictures(parts, alone), at_rest)
            pushed = truly_warped(parts, velocity, strength)
            row = [warp, f"{strength:g}", f"{threshold or 'none'}", f"{len(parts)}", takeover]
            for moved in (pushed, replace(parts, means=pushed.means)):
                row.append(score(pictures(moved, cameras), true_end))
            yield row


def split_longest(gaussians: Gaussians) -> Gaussians:
    """Every splat as three, longer than those that ``split_stretched`` makes and truer."""
    return split(gaussians, torch.arange(len(gaussians)), gaussians.log_scales.argmax(1), share=0.8)


def cost_table(source: Gaussians, target: Gaussians) -> None:
    """Seconds for 120 frames, best of five."""
    velocity = known_warps(torch.zeros(3).double(), bounds(source).radius)["swelling"]
    flow = fitted(source, truly_warped(source, velocity, 1.0), bounds(source))
    times = [i / 119 for i in range(120)]

    def seconds(ramp: str, covariance: str) -> float:
        begun = time.perf_counter()
        morph = Morph(source, target, flow, blend="union", ramp=ramp, covariance=covariance)
        for _ in morph.sequence(times):
            pass
        return time.perf_counter() - begun

    def row(ramp: str) -> list[str]:
        best = dict.fromkeys(COVARIANCES, math.inf)
        for _ in range(5):
            for mode in best:
                best[mode] = min(best[mode], seconds(ramp, mode))
        ratio = best["full"] / best["fixed"]
        return [ramp, *(f"{value:.2f}" for value in best.values()), f"{ratio:.1f}"]

    table(
        f"Seconds for 120 frames of {len(source) + len(target)} splats on "
        f"{torch.get_num_threads()} threads",
        ["ramp", *COVARIANCES, "full / fixed"],
        map(row, COMPARED),
    )


def main() -> None:
    """Print the tables asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("heads", nargs="+", type=Path)
    parser.add_argument("--only", choices=("warp", "shading", "self", "split", "cost"))
    asked = parser.parse_args()
    heads = {path.stem: io.read(path) for path in asked.heads}
    tables = {
        "warp": warp_table,
        "shading": shading_table,
        "self": self_table,
        "split": split_table,
    }
    for kind, make in tables.items():
        if asked.only in (None, kind):
            for name, head in heads.items():
                make(name, head)
    if asked.only in (None, "cost"):
        splats = list(heads.values())
        cost_table(splats[0], splats[-1])


if __name__ == "__main__":
    main()
