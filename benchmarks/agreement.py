"""What agreeing halves are worth: against truths, in motion, and where one side has more.

    python benchmarks/agreement.py truth A.ply B.ply       splat i of A is splat i of B
    python benchmarks/agreement.py warp HEAD.ply           known warps and a known recolouring
    python benchmarks/agreement.py motion A.ply B.ply      any pair with landmarks beside it
    python benchmarks/agreement.py cut A.ply B.ply         the same, B cut off below its landmarks
    python benchmarks/agreement.py cost A.ply B.ply        seconds and memory

truth    at t = 1/4, 1/2, 3/4 against the splats interpolated one by one, eight views of 512²
warp     the same against a head warped and recoloured part of the way; B is made of other splats
motion   61 frames from one camera, and the middle from many. In 1/255 of full brightness:
         flicker, the mean second difference of frames; jump, the largest step between frames in
         median steps; order, the second difference over a turn of 1° in ten steps at t = 1/2,
         in the ends'; patch, how unevenly the halves share the pixels, times how they differ;
         tint and ghost, how they differ below and above 4 px; swing, how far coverage at
         t = 1/4 … 3/4 is from linear where one side alone covers
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from fidelity import fitted, known_warps, table, truly_warped
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from renderer import Camera, orbit, rasterize
from splatmorph import io
from splatmorph.fitting import fit
from splatmorph.flows import Flow, make_flow
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import SH0
from splatmorph.geometry.quaternions import from_matrices, to_matrices
from splatmorph.images.quality import psnr, ssim
from splatmorph.landmarks import Landmarks
from splatmorph.morph import Morph
from splatmorph.morph.splitting import split
from splatmorph.rendering import bounds, renderer_arrays

SIZE = 512
AZIMUTHS = np.linspace(-45, 45, 8)
TIMES = (0.25, 0.5, 0.75)
LUMINANCE = np.array([0.299, 0.587, 0.114], np.float32)

METHODS = {
    "paper": {"blend": "union", "ramp": "linear", "covariance": "fixed"},
    "union": {"blend": "union"},
    "agree": {"blend": "agree"},
}

Picture = NDArray[np.float32]


@dataclass(frozen=True)
class Pair:
    """Two splats, the flow between them, and landmarks that it was fitted on."""

    source: Gaussians
    target: Gaussians
    flow: Flow
    landmarks: torch.Tensor

    def morph(self, method: str) -> Morph:
        """The morph of a method."""
        return Morph(
            self.source, self.target, self.flow, landmarks=self.landmarks, **METHODS[method]
        )

    def cameras(self, azimuths: Sequence[float] = AZIMUTHS, size: int = SIZE) -> list[Camera]:
        """Cameras round the front."""
        around = bounds(self.source, self.target)
        return orbit(around, azimuths, elevation=5, width=size, height=size)


def pair_of(first: Path, second: Path) -> Pair:
    """Two files with landmarks beside them, matched by name and fitted."""
    source, target = (replace(io.read(path), extras={}) for path in (first, second))
    sets = [Landmarks.read(Landmarks.beside(path)) for path in (first, second)]
    flow = make_flow("node", 3)
    fit(flow, *sets, domain=source.means.double())
    return Pair(source, target, flow, sets[0].match(sets[1])[0])


def cut(pair: Pair) -> Pair:
    """The target without what lies below its landmarks, and a little more."""
    marks, heights = pair.flow(pair.landmarks, 1.0)[:, 1], pair.target.means[:, 1]
    lowest = marks.min() - 0.1 * (marks.max() - marks.min())
    return replace(pair, target=pair.target.select((heights > lowest).nonzero().flatten()))


def picture(gaussians: Gaussians, camera: Camera) -> Picture:
    """The splat on white."""
    arrays = renderer_arrays(gaussians)
    rgb = rasterize(
        *arrays, camera.viewmat, camera.K, camera.width, camera.height, background=(1, 1, 1)
    )[0]
    return np.clip(rgb, 0, 1)


def coverage(gaussians: Gaussians, camera: Camera) -> Picture:
    """Its alpha."""
    arrays = renderer_arrays(gaussians)
    return rasterize(*arrays, camera.viewmat, camera.K, camera.width, camera.height)[1]


def sharpness(image: Picture) -> float:
    """Mean squared gradient of luminance."""
    down, across = np.gradient(image @ LUMINANCE)
    return float((down**2 + across**2).mean())


def against(found: Sequence[Picture], true: Sequence[Picture]) -> str:
    """Mean PSNR / SSIM over views."""
    pairs = [(torch.from_numpy(a), torch.from_numpy(b)) for a, b in zip(found, true, strict=True)]
    db, likeness = (np.mean([score(a, b) for a, b in pairs]) for score in (psnr, ssim))
    return f"{db:.2f} / {likeness:.3f}"


def truth_rows(pair: Pair, truth: dict[float, Gaussians], methods: Sequence[str]) -> Iterator:
    """Each method against the truth at each time; sharpness at 1/2 in the truth's."""
    cameras = pair.cameras()
    true = {t: [picture(g, c) for c in cameras] for t, g in truth.items()}
    aim = np.mean([sharpness(image) for image in true[0.5]])
    for method in methods:
        frames = zip(TIMES, pair.morph(method).sequence(TIMES), strict=True)
        found = {t: [picture(g, c) for c in cameras] for t, g in frames}
        crisp = np.mean([sharpness(image) for image in found[0.5]]) / aim
        yield [method, *(against(found[t], true[t]) for t in TIMES), f"{crisp:.2f}"]


def interpolated(a: Gaussians, b: Gaussians, t: float) -> Gaussians:
    """Splat i of ``a`` on its way to splat i of ``b``: the logarithms of covariance and of what is
    let through, center and colour on straight lines."""
    logs, vectors = torch.linalg.eigh((1 - t) * log_covariances(a) + t * log_covariances(b))
    vectors = vectors * torch.linalg.det(vectors)[:, None, None].sign()
    depths = [-torch.log1p(-g.opacities.double().clamp_max(0.9999)) for g in (a, b)]
    opacities = -torch.expm1(-torch.lerp(*depths, t))
    return Gaussians(
        torch.lerp(a.means, b.means, t),
        from_matrices(vectors).float(),
        (0.5 * logs).float(),
        opacities.clamp(1e-7, 1 - 1e-7).logit().float(),
        torch.lerp(a.sh, b.sh, t),
    )


def log_covariances(g: Gaussians) -> torch.Tensor:
    """(n, 3, 3) matrix logarithms."""
    axes = to_matrices(g.quats.double())
    return (axes * (2 * g.log_scales.double())[:, None]) @ axes.mT


def tinted(g: Gaussians, t: float, radius: float) -> Gaussians:
    """A smooth strong recolouring that varies over the object, linear in t."""
    x, y, z = ((g.means - g.means.median(0).values) / radius * 3).unbind(1)
    waves = [
        0.35 * torch.sin(1.3 * x + 0.5),
        0.3 * torch.cos(1.1 * y - 0.7 * z),
        -0.35 * torch.sin(z + 0.9 * x),
    ]
    shift = torch.stack(waves, 1)
    rgb = (0.5 + SH0 * g.sh[:, 0]) * (1 + 1.2 * shift * t) + 0.15 * shift * t
    return replace(g, sh=torch.cat([((rgb - 0.5) / SH0)[:, None], g.sh[:, 1:]], 1))


def resampled(g: Gaussians, share: float = 0.5) -> Gaussians:
    """The same object of other splats: a share of them split in three along the longest axis."""
    chosen = torch.randperm(len(g), generator=torch.Generator().manual_seed(0))
    chosen = chosen[: int(share * len(g))].sort().values
    return split(g, chosen, g.log_scales.argmax(1)[chosen])


def warped_pair(head: Gaussians, warp: str) -> tuple[Pair, dict[float, Gaussians]]:
    """The head, itself warped, recoloured and resampled, and the truths between."""
    around = bounds(head)
    radius = around.radius
    velocity = known_warps(torch.from_numpy(around.center).double(), radius)[warp]
    truth = {t: truly_warped(tinted(head, t, radius), velocity, t) for t in TIMES}
    whole = truly_warped(tinted(head, 1.0, radius), velocity, 1.0)
    flow = fitted(head, whole, around)
    return Pair(head, resampled(whole), flow, torch.empty(0, 3)), truth


def motion_row(name: str, pair: Pair, method: str) -> list[str]:
    """All figures of the middle and of a film."""
    around = pair.cameras(np.linspace(-45, 45, 4))
    (fixed,) = pair.cameras([20.0], 384)
    turn = pair.cameras(20 + 0.1 * np.arange(11), 384)
    ends = (pair.source, pair.target)
    morph = pair.morph(method)
    times = [k / 60 for k in range(61)]
    film = [picture(frame, fixed) for frame in morph.sequence(times)]
    steps = [float(np.abs(b - a).mean()) for a, b in pairwise(film)]
    middle = morph.at(0.5)
    crisp = np.mean([sharpness(picture(middle, c)) for c in around])
    crisp /= np.mean([sharpness(picture(end, c)) for end in ends for c in around])
    order = restless([picture(middle, c) for c in turn])
    order /= np.mean([restless([picture(end, c) for c in turn]) for end in ends])
    parts = np.mean([halves_apart(middle, len(pair.source), c) for c in around], axis=0)
    return [
        name,
        method,
        f"{crisp:.2f}",
        f"{restless(film):.3f}",
        f"{max(steps) / np.median(steps):.2f}",
        f"{order:.2f}",
        *(f"{value:.2f}" for value in parts),
        f"{uneven(morph, around):.3f}",
    ]


def restless(film: Sequence[Picture]) -> float:
    """The mean second difference, in 1/255."""
    triples = zip(film, film[1:], film[2:], strict=False)
    return float(np.mean([np.abs(a - 2 * b + c).mean() for a, b, c in triples])) * 255


def halves_apart(middle: Gaussians, count: int, camera: Camera) -> list[float]:
    """patch, tint and ghost of the middle, whose first ``count`` splats are the source's."""
    index = torch.arange(len(middle))
    halves = [middle.select(index[:count]), middle.select(index[count:])]
    rgb = []
    for half in halves:
        arrays = renderer_arrays(half)
        colour, alpha, _ = rasterize(*arrays, camera.viewmat, camera.K, SIZE, SIZE)
        rgb.append((colour / np.maximum(alpha, 1e-4)[..., None], alpha))
    flag = ((index >= count).float()[:, None, None].expand(-1, 1, 3) - 0.5) / SH0
    arrays = renderer_arrays(replace(middle, sh=flag.contiguous(), extras={}))
    share, alpha, _ = rasterize(*arrays, camera.viewmat, camera.K, SIZE, SIZE)
    share = share[..., 0] / np.maximum(alpha, 1e-4)
    both = (rgb[0][1] > 0.7) & (rgb[1][1] > 0.7)
    apart = rgb[0][0] - rgb[1][0]
    low = gaussian_filter(apart, (4, 4, 0))
    patch = np.abs(share - 0.5)[..., None] * np.abs(apart)
    return [float(value[both].mean()) * 255 for value in (patch, np.abs(low), np.abs(apart - low))]


def uneven(morph: Morph, cameras: Sequence[Camera]) -> float:
    """How far coverage is from linear in t where only one end covers, mean of absolutes."""
    off = []
    for camera in cameras:
        first, last = (coverage(end, camera) for end in (morph.source, morph.target))
        # What stays in its place: where neither the moved source nor the moved target gets to.
        lone = np.abs(first - last) > 0.9
        for t, frame in zip(TIMES, morph.sequence(TIMES), strict=True):
            linear = (1 - t) * first + t * last
            off.append(np.abs(coverage(frame, camera) - linear)[lone])
    return float(np.concatenate(off).mean())


MOTION = (
    "pair",
    "blend",
    "sharp",
    "flicker",
    "jump",
    "order",
    "patch",
    "tint",
    "ghost",
    "uneven",
)


def main() -> None:
    """Print the tables asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=("truth", "warp", "motion", "cut", "cost"))
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=METHODS)
    asked = parser.parse_args()
    columns = ["blend", *(f"t = {t}" for t in TIMES), "sharpness"]
    if asked.kind == "warp":
        for path in asked.files:
            head = replace(io.read(path), extras={})
            for warp in ("swelling", "twist 60°", "bend"):
                pair, truth = warped_pair(head, warp)
                table(f"{path.stem}, {warp}", columns, truth_rows(pair, truth, asked.methods))
        return
    pair = pair_of(*asked.files)
    name = "–".join(path.stem for path in asked.files)
    if asked.kind == "truth":
        truth = {t: interpolated(pair.source, pair.target, t) for t in TIMES}
        table(name, columns, truth_rows(pair, truth, asked.methods))
    elif asked.kind in ("motion", "cut"):
        pair = cut(pair) if asked.kind == "cut" else pair
        table(name, MOTION, (motion_row(name, pair, method) for method in asked.methods))
    else:
        begun = time.perf_counter()
        morph = pair.morph("agree")
        morph.at(0.5)
        print(f"{name}: first frame {time.perf_counter() - begun:.2f} s")
        print(f"peak {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")


if __name__ == "__main__":
    main()
