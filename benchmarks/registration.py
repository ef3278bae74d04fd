"""How good landmarks are that nobody picked: against truths, in random poses, scales and orders.

    python benchmarks/registration.py pairs DATA [--seeds 3] [--only NAME …] [--method auto]
    python benchmarks/registration.py poses DATA [--tries 30]

DATA is the folder of real inputs (heads/, meshes/, models/). Every target is turned
(uniformly on SO(3)), scaled (.3 to 3) and moved at random, and its splats are shuffled; errors are
those of ``fit`` on the landmarks found, measured back in the unposed target, mm.

pairs    face / all: mean error over the splats (marks, vertices) whose truth is known. Confidence:
         the whole's, and the mean error of the landmarks by quartile of their own confidence.
poses    the pose search alone: angle between the pose found and the true one.

Prints Markdown.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from splatmorph import io
from splatmorph.errors import SplatmorphError
from splatmorph.fitting import fit
from splatmorph.flows import make_flow
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.alignment import similarity_between
from splatmorph.geometry.quaternions import to_matrices
from splatmorph.geometry.similarity import Similarity
from splatmorph.landmarks import Landmarks
from splatmorph.registration import Found, find_landmarks
from splatmorph.registration.cleaning import without_floaters
from splatmorph.registration.pose import angle, find_poses
from splatmorph.registration.subject import prepare
from splatmorph.registration.surfaces import see_surface

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ASSETS = Path(__file__).parents[1] / "assets"
NOISE = 0.006
"""Metres by which a head's splat may be off its neighbours' median motion to count as truth."""
ON_FACE = 0.012
"""Metres from a landmark within which a head's splat belongs to the face."""
REST = ("hair", "whorl", "neck", "collar", "hem", "chest", "base")
"""Of the sample pair's marks: those that are not on the face."""
BASIN = 30.0
"""Degrees."""


@dataclass(frozen=True)
class Case:
    """Two splats and where points of the source belong on the target."""

    name: str
    source: Gaussians
    target: Gaussians
    points: Array
    """(m, 3)"""
    truth: Array
    """(m, 3)"""
    face: Mask
    """(m,)"""
    rest: Mask
    """(m,) what is reported beside the face: all, or what isn't face."""
    unit_mm: float = 1e3
    pose: Similarity | None = None
    """By which the target has been moved."""

    def posed(self, seed: int) -> Case:
        """The target in a random pose, scale and order."""
        rng = np.random.default_rng(1000 + seed)
        quat = torch.from_numpy(rng.normal(size=4))
        size = float(self.target.means.std())
        pose = Similarity(
            to_matrices(quat / quat.norm()),
            math.exp(rng.uniform(math.log(0.3), math.log(3))),
            torch.from_numpy(3 * size * rng.normal(size=3)),
        )
        order = torch.from_numpy(rng.permutation(len(self.target)))
        return replace(self, target=self.target.moved(pose).select(order), pose=pose)

    def back(self, points: torch.Tensor) -> Array:
        """Points on the target as it lay before it was posed."""
        return np.asarray(points if self.pose is None else self.pose.inverse()(points.double()))

    def errors(self, points: Array) -> tuple[float, float]:
        """Mean distance from the truth, mm: on the face, and on the rest."""
        off = self.unit_mm * np.linalg.norm(points - self.truth, axis=1)
        return float(off[self.face].mean()), float(off[self.rest].mean())

    def quartiles(self, found: Found) -> list[float]:
        """Mean error of the landmarks, mm, from the least to the most confident quarter."""
        p, q, _ = found.source.match(found.target)
        distance, near = cKDTree(self.points[self.rest]).query(p.numpy())
        known = distance < np.quantile(distance, 0.75)
        there = self.truth[self.rest][near] + p.numpy() - self.points[self.rest][near]
        off = self.unit_mm * np.linalg.norm(self.back(q) - there, axis=1)
        sure = np.asarray(found.source.confidence)
        order = np.flatnonzero(known)[np.argsort(sure[known])]
        return [float(off[part].mean()) for part in np.array_split(order, 4)]


def heads(data: Path, a: str, b: str) -> Case:
    """Two heads whose splats correspond by index, but for the noise of their training."""
    source, target = (io.read(data / "heads" / f"{name}.ply") for name in (a, b))
    p, _, _ = Landmarks.read(data / "heads" / f"{a}.landmarks.json").match(
        Landmarks.read(data / "heads" / f"{b}.landmarks.json")
    )
    x, y = source.means.double().numpy(), target.means.double().numpy()
    seen = np.logical_and(*(_covers(one) for one in (source, target)))
    index = np.flatnonzero(seen)
    near = index[cKDTree(x[index]).query(x[index], 13)[1]]
    motion = np.median((y - x)[near], 1)
    good = np.linalg.norm((y - x)[index] - motion, axis=1) < NOISE
    x, motion = x[index][good], motion[good]
    face = cKDTree(p.numpy()).query(x)[0] < ON_FACE
    return Case(f"{a} → {b}", source, target, x, x + motion, face, np.ones(len(x), bool))


def _covers(splat: Gaussians) -> Mask:
    """Splats that cover more than next to nothing."""
    scales = splat.scales.sort(1).values
    area = (splat.opacities * scales[:, 1] * scales[:, 2]).numpy()
    return np.asarray(area > 0.02 * np.quantile(area, 0.9))


def sample() -> Case:
    """The sample pair and its 222 true marks."""
    sides = [io.read(ASSETS / f"{name}.ply") for name in ("ines", "otto")]
    marks = (Landmarks.read(ASSETS / f"{name}.landmarks.json") for name in ("ines", "otto"))
    p, q, names = next(marks).match(next(marks))
    rest = np.array([name.startswith(REST) for name in names])
    return Case("ines → otto", *sides, p.numpy(), q.numpy(), ~rest, rest)


def warped(data: Path, name: str) -> Case:
    """A head against itself, twisted about its axis or with a swollen face: the truth is exact."""
    head = heads(data, "james", "james")
    means = head.source.means.double()
    _, middle, radius = see_surface(head.source, "expected")
    center = torch.from_numpy(middle)

    def twist(x: torch.Tensor) -> torch.Tensor:
        d = x - center
        turn = 0.6 * d[:, 1] / (1.5 * radius)
        c, s = turn.cos(), turn.sin()
        return center + torch.stack([c * d[:, 0] + s * d[:, 2], d[:, 1],
                                     c * d[:, 2] - s * d[:, 0]], 1)  # fmt: skip

    nose = torch.from_numpy(head.points[head.face].mean(0))

    def swell(x: torch.Tensor) -> torch.Tensor:
        d = x - nose
        near = torch.exp(-d.square().sum(1, keepdim=True) / (2 * (0.345 * radius) ** 2))
        return x + 0.35 * near * d

    warp = {"twist": twist, "swelling": swell}[name]
    truth = warp(torch.from_numpy(head.points)).numpy()
    return replace(
        head, name=name, target=replace(head.source, means=warp(means).float()), truth=truth
    )


def persons(data: Path, seed: int) -> Case:
    """Two random persons of ICT-FaceKit as grey splats at 20 000 and 22 000 of the vertices."""
    model = np.load(data / "meshes" / "ict_facekit.npz")
    rng = np.random.default_rng(seed)
    shapes = [
        model["neutral"] + np.tensordot(rng.uniform(-1.2, 1.2, 6), model["identity_modes"], 1)
        for _ in range(2)
    ]
    sides = [_grey(shape[rng.permutation(len(shape))[:count]])
             for shape, count in zip(shapes, (20_000, 22_000), strict=True)]  # fmt: skip
    face = np.zeros(len(shapes[0]), bool)
    face[model["face_vertices"]] = True
    return Case(f"persons {seed}", *sides, *shapes, face, np.ones(len(face), bool), unit_mm=10)


def _grey(points: Array) -> Gaussians:
    spacing = cKDTree(points).query(points, 5)[0][:, 1:].mean(1)
    count = len(points)
    return Gaussians(
        means=torch.from_numpy(points).float(),
        quats=torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
        log_scales=torch.from_numpy(np.log(0.6 * spacing)).float()[:, None].repeat(1, 3),
        opacity_logits=torch.full((count,), math.log(0.95 / 0.05)),
        sh=torch.zeros(count, 1, 3),
    )


def with_floaters(case: Case, count: int = 1500, seed: int = 0) -> Case:
    """The same with opaque floaters strewn round both heads."""

    def strewn(splat: Gaussians, rng: np.random.Generator) -> Gaussians:
        extra = splat.select(torch.from_numpy(rng.integers(len(splat), size=count)))
        middle = splat.means.mean(0)
        places = torch.from_numpy(rng.uniform(-0.4, 0.4, (count, 3))).float()
        extra = replace(
            extra, means=middle + places, opacity_logits=torch.full_like(extra.opacity_logits, 3.0)
        )
        return splat.union(extra)

    rng = np.random.default_rng(seed)
    return replace(
        case,
        name=f"{case.name}, {count} floaters",
        source=strewn(case.source, rng),
        target=strewn(case.target, rng),
    )


def cases(data: Path) -> dict[str, tuple[Callable[[], Case], tuple[str, ...]]]:
    """How each case is made, and by which methods it is judged."""
    both = ("auto", "surface")
    made: dict[str, tuple[Callable[[], Case], tuple[str, ...]]] = {
        "james-status": (partial(heads, data, "james", "status"), both),
        "status-p2-1": (partial(heads, data, "status", "p2-1"), both),
        "james-p2-1": (partial(heads, data, "james", "p2-1"), both),
        "ines-otto": (sample, both),
        "twist": (partial(warped, data, "twist"), both),
        "swelling": (partial(warped, data, "swelling"), both),
        "floaters": (lambda: with_floaters(heads(data, "james", "status")), ("auto",)),
    }
    for seed in range(10):
        made[f"persons-{seed}"] = partial(persons, data, seed), ("surface",)
    return made


def carried(found: Found, points: Array) -> torch.Tensor:
    """Points of the source on the target, by the product's own fit on the landmarks."""
    p, q, names = found.source.match(found.target)
    frame = similarity_between(p, q)
    flow = make_flow("node", dim=3)
    fit(flow, Landmarks(p, names), Landmarks(frame.inverse()(q), names))
    return frame(flow(torch.from_numpy(points), 1.0).double())


def tried(case: Case, method: str, model: Path, seed: int) -> str:
    """A row of the table."""
    begun = time.process_time()
    found = find_landmarks(case.source, case.target, method, face_model=model, seed=seed)
    seconds = time.process_time() - begun
    nothing = case.errors(case.points)
    errors = case.errors(case.back(carried(found, case.points)))
    quarters = " / ".join(f"{value:.1f}" for value in case.quartiles(found))
    return (
        f"| {case.name} | {found.how} | {seed} | {nothing[0]:.2f} / {nothing[1]:.2f} "
        f"| {errors[0]:.2f} / {errors[1]:.2f} | {quarters} | {found.confidence:.2f} "
        f"| {len(found.warnings)} | {seconds:.1f} |"
    )


def pairs(data: Path, only: list[str], methods: list[str], seeds: int, as_is: bool) -> None:
    """Print the table of the pairs."""
    model = data / "models" / "face_landmarker.task"
    print(
        "| pair | by | seed | as they lie | found | by quarter of confidence | sure | warned | s |"
    )
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    for name, (make, judged) in cases(data).items():
        if only and name not in only:
            continue
        case = make()
        for method in judged:
            if method not in methods:
                continue
            for seed in range(seeds):
                moved = case if as_is else case.posed(seed)
                try:
                    print(tried(moved, method, model, seed), flush=True)
                except SplatmorphError as error:
                    print(f"| {case.name} | {method} | {seed} | {error} |", flush=True)


def poses(data: Path, tries: int) -> None:
    """Print the angle by which each pose found is off."""
    names = ("james-status", "status-p2-1", "james-p2-1", "ines-otto", "twist", "swelling", "same")
    print("| pair | try | off by | scale | lead of the best |\n|---|---|---|---|---|", flush=True)
    right = 0
    for number in range(tries):
        name = names[number % len(names)]
        made = heads(data, "james", "james") if name == "same" else cases(data)[name][0]()
        case = made.posed(number)
        source, target = (prepare(without_floaters(g)) for g in (case.source, case.target))
        found = find_poses(source, target, target.to_unit @ source.to_unit.inverse())
        world = target.to_unit.inverse() @ found[0].similarity @ source.to_unit
        assert case.pose is not None
        off = angle(world, case.pose)
        right += off < BASIN
        print(f"| {case.name} | {number} | {off:.2f}° | {world.scale / case.pose.scale:.3f} "
              f"| {found[0].score:.2f} of {[round(p.score, 2) for p in found[1:3]]} |",
              flush=True)  # fmt: skip
    print(f"\nright basin: {right} of {tries}")


def main() -> None:
    """Run one of the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["pairs", "poses"])
    parser.add_argument("data", type=Path)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--tries", type=int, default=30)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--method", nargs="*", default=["auto", "surface"])
    parser.add_argument("--as-is", action="store_true", help="leave the targets as they lie")
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.what == "pairs":
        pairs(options.data, options.only, options.method, options.seeds, options.as_is)
    else:
        poses(options.data, options.tries)


if __name__ == "__main__":
    main()
