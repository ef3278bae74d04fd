"""The landmark pairs that the benchmarks run on, read from the folder of real inputs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from splatmorph import io
from splatmorph.landmarks import Landmarks

FLAME_VERTICES = 5023
"""Splat i of a head lies at FLAME vertex i: a dense, noisy truth."""


@dataclass(frozen=True)
class Pair:
    """Landmarks of two objects and, where there is one, the dense truth beside them."""

    name: str
    source: Landmarks
    target: Landmarks
    held_source: torch.Tensor | None = None
    """(m, dim) points of the source …"""
    held_target: torch.Tensor | None = None
    """… and where they belong on the target."""
    unit_mm: float = 1.0
    """Millimetres a world unit (pixels for pictures)."""


def nersemble(data: Path) -> Pair:
    """The paper's 254 FLAME landmarks on two NeRSemble heads, metres."""
    sides = (
        Landmarks.read(data / "landmarks3d" / f"nersemble_{person}.landmarks.json")
        for person in ("018", "032")
    )
    return Pair("NeRSemble 018-032", *sides, unit_mm=1000)


def frll(data: Path) -> Pair:
    """The hand-placed landmarks on FRLL faces 001 and 002, pixels; the last of two that share a
    point on one side only is left out, since no flow can follow both."""
    stored = json.loads((data / "faces2d" / "flowing_manual_landmarks_001_002.json").read_text())
    sides = [np.asarray(stored[side])[:, ::-1] for side in ("points_0", "points_1")]
    first = [np.unique(side, axis=0, return_index=True)[1] for side in sides]
    kept = np.intersect1d(*first)
    marks = (Landmarks(torch.tensor((side[kept] + 1) / 2 * 1350)) for side in sides)
    return Pair("FRLL 001-002", *marks)


def head(data: Path, a: str, b: str) -> Pair:
    """Two trained Gaussian heads, metres; what corresponds is known but for the fitting noise."""
    folder = data / "heads"
    landmarks = (Landmarks.read(folder / f"{name}.landmarks.json") for name in (a, b))
    dense = (io.read(folder / f"{name}.ply").means[:FLAME_VERTICES].double() for name in (a, b))
    return Pair(f"heads {a}-{b}", *landmarks, *dense, unit_mm=1000)


def heads(data: Path) -> list[Pair]:
    """Both pairs of heads."""
    return [head(data, "james", "status"), head(data, "p2-1", "status")]


def persons(data: Path, count: int, seed: int = 0) -> Iterator[Pair]:
    """Random persons of ICT-FaceKit: 68 landmarks, scored on the face's other vertices, cm."""
    model = np.load(data / "meshes" / "ict_facekit.npz")
    landmarks = model["landmarks68"]
    held = np.setdiff1d(model["face_vertices"], landmarks)
    rng = np.random.default_rng(seed)
    for i in range(count):
        meshes = [
            torch.tensor(
                model["neutral"] + np.tensordot(rng.normal(0, 1.2, 6), model["identity_modes"], 1),
                dtype=torch.float64,
            )
            for _ in range(2)
        ]
        sides = [Landmarks(mesh[landmarks]) for mesh in meshes]
        yield Pair(f"persons {i}", *sides, *(mesh[held] for mesh in meshes), unit_mm=10)
