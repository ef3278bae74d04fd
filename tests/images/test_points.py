"""Landmarks of pictures: conventions said, never guessed; anchors; what no flow can follow."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scenes import some_landmarks

from splatmorph.errors import LandmarkError, OptionError, ReadError
from splatmorph.images import CONVENTIONS, Canvas, read_pair, read_points, with_anchors
from splatmorph.images.points import beside, merged
from splatmorph.landmarks import Landmarks

CANVAS = Canvas(200, 100)
PIXELS = torch.tensor([[0.5, 0.5], [150.5, 20.5], [199.5, 99.5]], dtype=torch.float64)
"""The centers of three pixels."""
IN_EACH = {
    "pixels-xy": [[0, 0], [150, 20], [199, 99]],
    "pixels-rc": [[0, 0], [20, 150], [99, 199]],
    "unit-xy": [[-0.995, -0.99], [0.505, -0.59], [0.995, 0.99]],
    "unit-rc": [[-0.99, -0.995], [-0.59, 0.505], [0.99, 0.995]],
}


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("said", [True, False])
@pytest.mark.parametrize("kind", ["txt", "csv", "json", "npz", "npy"])
def test_every_convention_means_the_same_points(
    tmp_path: Path, convention: str, said: bool, kind: str
) -> None:
    rows = IN_EACH[convention]
    path = tmp_path / f"points.{kind}"
    if kind in ("txt", "csv"):
        gap = " " if kind == "txt" else ","
        head = f"# convention: {convention}\n" if said else ""
        path.write_text(head + "\n".join(f"{a}{gap}{b}" for a, b in rows) + "\n")
    elif kind == "json":
        points = {f"p{i}": row for i, row in enumerate(rows)}
        path.write_text(
            json.dumps({"points": points} | ({"convention": convention} if said else {}))
        )
    elif kind == "npz":
        np.savez(path, points=rows, **({"convention": convention} if said else {}))
    else:
        np.save(path, rows)
    if said and kind != "npy":
        found = read_points(path, CANVAS)
    else:
        with pytest.raises(LandmarkError, match="does not say what its coordinates mean"):
            read_points(path, CANVAS)
        found = read_points(path, CANVAS, convention)
    assert torch.allclose(CANVAS.to_pixels(found.points), PIXELS)


def test_templates_and_ibug_points_are_pixels(tmp_path: Path) -> None:
    (tmp_path / "a.tem").write_text("3\n0 0\n150\t20\n199 99\n1\n0\n2\n0 1\n0\n")
    (tmp_path / "a.pts").write_text("version: 1\nn_points: 3\n{\n1 1\n151 21\n200 100\n}\n")
    for name in ("a.tem", "a.pts"):
        assert torch.allclose(CANVAS.to_pixels(read_points(tmp_path / name, CANVAS).points), PIXELS)


def test_the_papers_pair_file(tmp_path: Path) -> None:
    rows = IN_EACH["unit-rc"]
    (tmp_path / "pair.json").write_text(json.dumps({"points_0": rows, "points_1": rows[::-1]}))
    pair = read_pair(tmp_path / "pair.json", CANVAS, CANVAS)
    assert pair is not None
    assert torch.allclose(CANVAS.to_pixels(pair[0].points), PIXELS)
    assert torch.allclose(pair[1].points, pair[0].points.flip(0))
    (tmp_path / "one.json").write_text(json.dumps({"points": rows}))
    assert read_pair(tmp_path / "one.json", CANVAS, CANVAS) is None


def test_landmarks_are_found_beside_the_picture(tmp_path: Path) -> None:
    assert beside(tmp_path / "a.jpg") is None
    (tmp_path / "a.tem").touch()
    assert beside(tmp_path / "a.jpg") == tmp_path / "a.tem"
    (tmp_path / "a.landmarks.csv").touch()
    assert beside(tmp_path / "a.jpg") == tmp_path / "a.landmarks.csv"


def test_conventions_that_contradict_or_are_unknown(tmp_path: Path) -> None:
    path = tmp_path / "p.txt"
    path.write_text("# convention: pixels-xy\n1 2\n3 4\n5 7\n")
    with pytest.raises(LandmarkError, match="says its convention is pixels-xy, but pixels-rc"):
        read_points(path, CANVAS, "pixels-rc")
    with pytest.raises(OptionError, match="'matlab' is unknown"):
        read_points(path, CANVAS, "matlab")


def test_points_outside_the_picture_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "p.txt"
    path.write_text("1 2\n3 4\n150 90\n")
    assert len(read_points(path, CANVAS, "pixels-xy")) == 3
    with pytest.raises(
        LandmarkError, match=r"1 of 3 landmarks lie outside.*\(90, 150\) of 200x100"
    ):
        read_points(path, CANVAS, "pixels-rc")


@pytest.mark.parametrize(
    ("name", "text", "complaint"),
    [
        ("a.tem", "three\n0 0\n", "no whole template"),
        ("a.tem", "3\n0 0\n1 1\n", "announces 3 points"),
        ("a.tem", "2\n0 0\n1 x\n", "could not convert string to float: 'x'"),
        ("a.pts", "0 0\n1 1\n", r"no \.pts file"),
        ("a.pts", "n_points: 2\n{\n0 0\n}\n", "announces 2 points"),
        ("a.json", "{", "no whole JSON file"),
        ("a.json", '{"points_0": [[0, 1]], "points_1": "none"}', "'points_1' should hold rows"),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, name: str, text: str, complaint: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ReadError, match=complaint):
        read_pair(tmp_path / name, CANVAS, CANVAS) or read_points(tmp_path / name, CANVAS)
    with pytest.raises(ReadError, match="No such file"):
        read_points(tmp_path / "missing.tem", CANVAS)


def test_anchors_hold_the_frame() -> None:
    canvases = (CANVAS, Canvas(100, 100))
    source, target = with_anchors(*some_landmarks(5), canvases, 2)
    assert len(source) == len(target) == 13
    assert torch.equal(source.points[5:], canvases[0].border(2))
    assert torch.equal(target.points[5:], canvases[1].border(2))
    assert len(with_anchors(*some_landmarks(5), canvases, 0)[0]) == 5


@given(st.permutations(range(6)))
def test_pairs_that_coincide_become_their_mean(order: list[int]) -> None:
    p = torch.tensor([[0, 0], [0.5, 0], [0, 0.5], [0.5, 0.5], [0, 0.001], [0.501, 0.5]]).double()
    q = torch.tensor([[0, 0], [0.5, 0], [0, 0.5], [0.5, 0.5], [0, 0.001], [0.7, 0.5]]).double()
    names = [f"p{i}" for i in range(6)]
    source = Landmarks(p[order], tuple(names[i] for i in order))
    one, other = merged(source, Landmarks(q, tuple(names)))
    # p4 is p0 in both; p5 lies beside p3 in the source only, which a flow can follow.
    assert len(one) == len(other) == 5
    assert {frozenset(name.split("+")) for name in one.names or ()} == {
        frozenset({"p0", "p4"}), frozenset({"p1"}), frozenset({"p2"}), frozenset({"p3"}),
        frozenset({"p5"}),
    }  # fmt: skip
    assert torch.allclose(one.points.sort(0).values[0], torch.tensor([0, 0.0]).double(), atol=1e-3)


def test_sets_that_do_not_match_are_refused() -> None:
    p, q = some_landmarks(6)
    with pytest.raises(LandmarkError, match="6 source and 5 target landmarks"):
        merged(p, Landmarks(q.points[:5]))
    named = [Landmarks(p.points[:3], tuple(names)) for names in ("abc", "def")]
    with pytest.raises(LandmarkError, match="expected at least 3"):
        merged(*named)
    torn, twice = q.points.clone(), p.points.clone()
    torn[1] += 0.5
    twice[1] = twice[0]
    with pytest.raises(LandmarkError, match="one and the same point"):
        with_anchors(Landmarks(twice), Landmarks(torn), (CANVAS, CANVAS), 0)
