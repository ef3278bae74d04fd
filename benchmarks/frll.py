"""The paper's table of faces, on the pairs of a folder of them, through ``splatmorph batch``.

    python benchmarks/frll.py FACES [-o FOLDER] [--pairs 100] [--methods node,tps] [--workers 2]

FACES is a folder (it and those below are looked through) of pictures with WebMorph templates
beside them, ``001_03.jpg`` and ``001_03.tem``. Of all pairs so many are drawn with a fixed seed.
Template points that fall together in one of the faces only are left out of all: no flow can part
them. Runs are kept in FOLDER, so that the same command goes on. Prints Markdown.

The landmark error is a coordinate's, over ten times, in units in which a picture's longer side is
2. The determinant is that of the warps to either end over 256 × 256 pixels, folding the share of
these that are turned over.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import random
import statistics
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from splatmorph.app import run as splatmorph
from splatmorph.images import Picture, read_points

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
    asked = parser.parse_args()
    faces = read_faces(asked.faces)
    pairs = list(itertools.combinations(faces, 2))
    random.Random(0).shuffle(pairs)
    pairs = pairs[: asked.pairs]
    with tempfile.TemporaryDirectory() as scratch:
        folder = asked.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        table = write_table(folder, pairs)
        count = len(faces[0].points)
        print(f"{len(pairs)} pairs of {len(faces)} faces, {count} landmarks\n")
        print(f"| | {' | '.join(COLUMNS)} |")
        print("|---" * (len(COLUMNS) + 1) + "|")
        for method in asked.methods.split(","):
            runs = folder / method
            words = ["-q", "batch", table, "-o", runs]
            words += ["--image", f"{METHODS[method]} --size {asked.size}"]
            words += ["--workers", asked.workers] if asked.workers else []
            splatmorph([str(word) for word in words])
            with (runs / "summary.csv").open(newline="", encoding="utf-8") as stream:
                print(line(method, list(csv.DictReader(stream))), flush=True)
    for name in sorted(PAPER.keys() - set(asked.methods.split(","))):
        print(f"| {name} {'| ' * len(COLUMNS)}{PAPER[name]:.1e} |")


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


def line(method: str, rows: Sequence[dict[str, str]]) -> str:
    """What a summary says of a method."""
    done = [row for row in rows if row["status"] != "failed"]

    def column(name: str) -> list[float]:
        return [float(row[name]) for row in done if row[name]]

    # Delaunay takes its corners to their places, whatever happens between.
    mse, det, folded = column("mse") or [0.0], column("det_min"), column("folded")
    seconds = statistics.median(column("seconds") or [0.0])
    paper = f"{PAPER[method]:.1e}" if method in PAPER else ""
    return (
        f"| {method} | {statistics.median(mse):.1e} | {statistics.mean(mse):.1e} | {max(mse):.1e} "
        f"| {statistics.median(det):.2f} | {min(det):.2f} | {sum(f > 0 for f in folded)} "
        f"| {max(folded):.2%} | {seconds:.2f} | {len(rows) - len(done)} | {paper} |"
    )


if __name__ == "__main__":
    main()
