"""The paper's table of faces, on the pairs of a folder of them, through ``splatmorph batch``.

    python benchmarks/frll.py FACES [-o FOLDER] [--pairs 100] [--methods node,tps] [--workers 2]
        [--lpips-weights DIR] [--inception-weights FILE]

FACES is a folder (it and those below are looked through) of pictures with WebMorph templates
beside them, ``001_03.jpg`` and ``001_03.tem``. Of all pairs so many are drawn with a fixed seed.
Template points that fall together in one of the faces only are left out of all: no flow can part
them. Runs are kept in FOLDER, so that the same command goes on. Prints Markdown.

The landmark error is a coordinate's, over ten times, in units in which a picture's longer side is
2. The determinant is that of the warps to either end over 256 × 256 pixels, folding the share of
these that are turned over.

With weights (extra ``metrics``; torchvision's of AlexNet, VGG 16 or SqueezeNet 1.1 in DIR,
pytorch-fid's in FILE) a second table has the mean LPIPS of the middle pictures to both ends, and
the FID of all of them to the faces at the same size. FID is the larger the fewer pictures there
are: compare methods over the same pairs.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import itertools
import json
import random
import statistics
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from splatmorph.app import run as splatmorph
from splatmorph.errors import SplatmorphError
from splatmorph.images import Canvas, Picture, read_points
from splatmorph.images.perception import Inception, Lpips, frechet_distance

METHODS = {
    "node": "--warp node",
    "siren": "--warp node --field siren",
    "ncf": "--warp ncf",
    "ifmorph": "--warp ifmorph",
    "tps": "--warp tps",
    "delaunay": "--warp delaunay",
}
QUICK = "node,siren,ncf,tps,delaunay"
PAPER = {
    "siren": 1.4e-4,
    "siren, sigmoid": 6.2e-2,
    "ncf": 3.9e-5,
    "ncf, sigmoid": 8.7e-3,
    "ifmorph": 1.5e-3,
}
"""Landmark MSE on FRLL, 68 points, as published."""

PAPER_LOOKS = {
    "siren": (0.210, 0.213, 32.0),
    "ncf": (0.221, 0.224, 33.3),
    "ifmorph": (0.250, 0.252, 38.4),
    "tps": (0.371, 0.374, None),
    "delaunay": (0.233, 0.236, 32.4),
}
"""LPIPS to source and target, FID: of linear blends on FRLL, as published; Delaunay is OpenCV's."""

COLUMNS = (
    "MSE, median",
    "mean",
    "worst",
    "least det, median",
    "worst",
    "pairs that fold",
    "folded, worst",
    "fit, s",
    "failed",
    "the paper's MSE",
)
LOOKS = ("LPIPS to source", "to target", "FID", "the paper's", "to target", "FID")


class Face(NamedTuple):
    """A picture and its landmarks, pixels that count from 0."""

    picture: Path
    points: np.ndarray


def main() -> None:
    """Fit the pairs and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("faces", type=Path)
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--pairs", type=int, default=100)
    parser.add_argument("--methods", default=QUICK, help=f"of {','.join(METHODS)}")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--size", default="256x256", help="of the pictures that are made")
    parser.add_argument("--lpips-weights", type=Path, metavar="DIR")
    parser.add_argument("--inception-weights", type=Path, metavar="FILE")
    asked = parser.parse_args()
    asked.methods = asked.methods.split(",")
    if unknown := set(asked.methods) - METHODS.keys():
        parser.error(f"no methods: {', '.join(sorted(unknown))}; expected {','.join(METHODS)}")
    with tempfile.TemporaryDirectory() as scratch:
        try:
            compare(asked, asked.out or Path(scratch))
        except SplatmorphError as error:
            raise SystemExit(f"error: {error}") from error


def compare(asked: argparse.Namespace, folder: Path) -> None:
    """Fit the pairs into ``folder`` and print."""
    faces = read_faces(asked.faces)
    pairs = draw_pairs(faces, asked.pairs)
    eyes = Eyes(
        Canvas(*map(int, asked.size.split("x"))),
        asked.lpips_weights and Lpips.load(asked.lpips_weights),
        asked.inception_weights and Inception.load(asked.inception_weights),
        tuple(pairs),
    )
    folder.mkdir(parents=True, exist_ok=True)
    table = write_table(folder, pairs)
    print(f"{len(pairs)} pairs of {len(faces)} faces, {len(faces[0].points)} landmarks\n")
    print(heading(COLUMNS))
    looks = []
    for method in asked.methods:
        runs = folder / method
        rows = morph(table, runs, f"{METHODS[method]} --size {asked.size}", asked.workers)
        print(line(method, rows), flush=True)
        if eyes.open:
            looks.append(eyes.line(method, [runs / f"{row['name']}.png" for row in rows]))
    for name in sorted(PAPER.keys() - set(asked.methods)):
        print(f"| {name} {'| ' * len(COLUMNS)}{PAPER[name]:.1e} |")
    if looks:
        trunk = f" by {eyes.lpips.trunk}" if eyes.lpips else ""
        print(f"\nLPIPS{trunk}, FID to {len(eyes.faces)} faces\n\n{heading(LOOKS)}")
        print("\n".join(looks))


def morph(table: Path, runs: Path, words: str, workers: int | None) -> list[dict[str, Any]]:
    """What ``splatmorph batch`` says of each pair."""
    call = ["batch", table, "-o", runs, "--image", words, "--json"]
    call += ["--workers", workers] if workers else []
    with contextlib.redirect_stdout(io.StringIO()) as said:
        code = splatmorph([str(word) for word in call])
    if not said.getvalue():
        raise SystemExit(code)
    return json.loads(said.getvalue())["pairs"]


def read_faces(folder: Path) -> list[Face]:
    """The faces of a folder, without the landmarks that fall together in one of them."""
    found = []
    for template in sorted(folder.rglob("*.tem")):
        pictures = [template.with_suffix(end) for end in (".jpg", ".png")]
        picture = next((one for one in pictures if one.is_file()), None)
        if picture is not None:
            canvas = Picture.read(picture).canvas
            world = read_points(template, canvas).points
            found.append(Face(picture, (canvas.to_pixels(world) - 0.5).numpy()))
    if len(found) < 2:
        raise SystemExit(f"{folder} holds {len(found)} pictures with a .tem beside, expected two")
    distinct = set(range(len(found[0].points)))
    for face in found:
        distinct &= set(np.unique(face.points.round(3), axis=0, return_index=True)[1].tolist())
    kept = sorted(distinct)
    return [Face(face.picture, face.points[kept]) for face in found]


def draw_pairs(faces: Sequence[Face], count: int) -> list[tuple[Face, Face]]:
    """So many of all pairs, the same each time."""
    pairs = list(itertools.combinations(faces, 2))
    random.Random(0).shuffle(pairs)
    return pairs[:count]


def write_table(folder: Path, pairs: Sequence[tuple[Face, Face]]) -> Path:
    """The table of a batch, the landmarks beside it."""
    marks = folder / "landmarks"
    marks.mkdir(exist_ok=True)
    for face in {face.picture: face for pair in pairs for face in pair}.values():
        rows = "".join(f"{x:.17g}\t{y:.17g}\n" for x, y in face.points)
        (marks / f"{face.picture.stem}.tem").write_text(f"{len(face.points)}\n{rows}0\n")
    path = folder / "pairs.csv"
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["kind", "source", "target", "source_landmarks", "target_landmarks"])
        for pair in pairs:
            pictures = [face.picture.resolve() for face in pair]
            beside = [f"landmarks/{picture.stem}.tem" for picture in pictures]
            writer.writerow(["pictures", *pictures, *beside])
    return path


def heading(columns: Sequence[str]) -> str:
    """The head of a table of methods."""
    return f"| | {' | '.join(columns)} |\n|{'---|' * (len(columns) + 1)}"


def line(method: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """What a batch says of a method."""
    done = [row for row in rows if row["status"] != "failed"]

    def column(name: str) -> list[float]:
        return [row[name] for row in done if row[name] is not None]

    # Delaunay takes its corners to their places, whatever happens between.
    mse, det, folded = column("mse") or [0.0], column("det_min"), column("folded")
    if not det:
        return f"| {method} {'| ' * (len(COLUMNS) - 1)}| {len(rows)} | |"
    seconds = statistics.median(column("seconds") or [0.0])
    paper = f"{PAPER[method]:.1e}" if method in PAPER else ""
    return (
        f"| {method} | {statistics.median(mse):.1e} | {statistics.mean(mse):.1e} | {max(mse):.1e} "
        f"| {statistics.median(det):.2f} | {min(det):.2f} | {sum(f > 0 for f in folded)} "
        f"| {max(folded):.2%} | {seconds:.2f} | {len(rows) - len(done)} | {paper} |"
    )


@dataclass(frozen=True)
class Eyes:
    """What looks at the pictures that are made, where there are weights for it."""

    canvas: Canvas
    lpips: Lpips | None
    inception: Inception | None
    pairs: tuple[tuple[Face, Face], ...]

    @property
    def open(self) -> bool:
        """Whether there is anything to see with."""
        return self.lpips is not None or self.inception is not None

    @cached_property
    def faces(self) -> dict[Path, torch.Tensor]:
        """The pictures of the pairs, as small as those that are made of them."""
        paths = sorted({face.picture for pair in self.pairs for face in pair})
        return {path: Picture.read(path).with_channels(3).planes(self.canvas) for path in paths}

    @cached_property
    def seen(self) -> torch.Tensor:
        """The features of the faces."""
        return self.inception.features(self.faces.values())

    def line(self, method: str, made: Sequence[Path]) -> str:
        """How the middles ``made`` of each pair look, beside the paper's."""
        done = [(pair, path) for pair, path in zip(self.pairs, made, strict=True) if path.is_file()]
        middles = [Picture.read(path).with_channels(3).planes() for _, path in done]
        found: list[float | None] = [None, None, None]
        if self.lpips and done:
            for end in (0, 1):
                found[end] = statistics.mean(
                    self.lpips(self.faces[pair[end].picture], middle)
                    for (pair, _), middle in zip(done, middles, strict=True)
                )
        if self.inception and done:
            found[2] = frechet_distance(self.inception.features(middles), self.seen)
        cells = [*found, *PAPER_LOOKS.get(method, (None,) * 3)]
        shown = ("" if cell is None else f"{cell:#.3g}" for cell in cells)
        return f"| {method} | {' | '.join(shown)} |"


if __name__ == "__main__":
    main()
