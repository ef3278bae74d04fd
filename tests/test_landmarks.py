"""Landmarks: every format says the same points; what can't be meant is refused by name."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from splatmorph.errors import LandmarkError, OptionError, ReadError
from splatmorph.landmarks import Landmarks

NAMES = ("nose", "chin", "left ear", "right ear", "crown")
POINTS = [[0.0, 0.0, 1.0], [0.0, -1.0, 0.5], [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.25, 0.0]]


def named(points: list[list[float]] = POINTS, names: tuple[str, ...] = NAMES) -> Landmarks:
    return Landmarks(torch.tensor(points), names)


# Laws ---------------------------------------------------------------------------------------


@given(order=st.permutations(range(len(NAMES))), dropped=st.integers(0, 1))
def test_matching_by_name_ignores_order_and_extras(order: list[int], dropped: int) -> None:
    kept = order[dropped:]
    other = named([POINTS[i] for i in kept], tuple(NAMES[i] for i in kept))
    p, q, names = named().match(other)
    assert torch.equal(p, q)
    assert names == tuple(name for i, name in enumerate(NAMES) if i in kept)


def test_json_comes_back_exactly(tmp_path: Path) -> None:
    points = torch.randn(9, 3, dtype=torch.float64)
    written = Landmarks(points, tuple("abcdefghi"))
    written.write(tmp_path / "x.landmarks.json")
    again = Landmarks.read(tmp_path / "x.landmarks.json")
    assert torch.equal(again.points, points)
    assert again.names == written.names
    Landmarks(points).write(tmp_path / "y.json")
    assert Landmarks.read(tmp_path / "y.json").names is None


@pytest.mark.parametrize("names", [tuple("abcdefghi"), None])
def test_confidence_comes_back(tmp_path: Path, names: tuple[str, ...] | None) -> None:
    sure = torch.linspace(0, 1, 9, dtype=torch.float64)
    found = Landmarks(torch.randn(9, 3, dtype=torch.float64), names, sure)
    found.write(tmp_path / "x.json")
    again = Landmarks.read(tmp_path / "x.json")
    assert again.confidence is not None
    assert torch.equal(again.confidence, sure)


@pytest.mark.parametrize(
    "confidence", ["[0.5]", '{"a": 2, "b": 0}', "[0.1, NaN]", '{"a": {}}', '"x"']
)
def test_damaged_confidences_are_refused(tmp_path: Path, confidence: str) -> None:
    path = tmp_path / "x.json"
    points = '{"a": [0, 0, 0], "b": [1, 0, 0]}'
    path.write_text(f'{{"points": {points}, "confidence": {confidence}}}')
    with pytest.raises((ReadError, LandmarkError)):
        Landmarks.read(path)


def test_what_a_person_adds_to_what_was_found_is_sure(tmp_path: Path) -> None:
    points = '{"a": [0, 0, 0], "b": [1, 0, 0]}'
    (tmp_path / "x.json").write_text(f'{{"points": {points}, "confidence": {{"a": 0.5}}}}')
    found = Landmarks.read(tmp_path / "x.json").confidence
    assert found is not None
    assert found.tolist() == [0.5, 1.0]


# Formats ------------------------------------------------------------------------------------


def write_all(folder: Path) -> dict[str, bool]:
    """Every format, and whether it carries the names."""
    array = np.array(POINTS)
    np.save(folder / "a.npy", array)
    np.savez(folder / "b.npz", array)
    np.savez(folder / "c.npz", points=array, names=np.array(NAMES))
    rows = [" ".join(map(str, row)) for row in POINTS]
    (folder / "d.txt").write_text("# x y z\n" + "\n".join(rows) + "\n")
    rows = [row.replace(" ", ",") for row in rows]
    (folder / "e.csv").write_text("x,y,z\n" + "\n".join(rows) + "\n")
    rows = [f"{name},{row}" for name, row in zip(NAMES, rows, strict=True)]
    (folder / "f.csv").write_text("name,x,y,z\n" + "\n".join(rows) + "\n")
    (folder / "g.csv").write_text("\n".join(rows))
    picked = "".join(
        f'<point x="{x}" y="{y}" z="{z}" name="{name}" active="1"/>'
        for name, (x, y, z) in zip(NAMES, POINTS, strict=True)
    )
    ignored = '<point x="9" y="9" z="9" name="off" active="0"/>'
    (folder / "h.pp").write_text(
        f"<!DOCTYPE PickedPoints><PickedPoints>{picked}{ignored}</PickedPoints>"
    )
    (folder / "i.json").write_text(json.dumps(POINTS))
    (folder / "j.json").write_text(json.dumps({"points": dict(zip(NAMES, POINTS, strict=True))}))
    with_names = "cfghj"
    return {file.name: file.stem in with_names for file in folder.iterdir()}


def test_every_format_reads_the_same(tmp_path: Path) -> None:
    formats = write_all(tmp_path)
    assert len(formats) == 10
    for name, has_names in formats.items():
        read = Landmarks.read(tmp_path / name)
        assert torch.equal(read.points, torch.tensor(POINTS, dtype=torch.float64)), name
        assert read.names == (NAMES if has_names else None), name


def test_numeric_names_under_a_header(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("vertex,x,y,z\n017,1,2,3\n18,4,5,6\n")
    assert Landmarks.read(tmp_path / "x.csv").names == ("017", "18")


def test_landmarks_are_found_beside_the_input(tmp_path: Path) -> None:
    assert Landmarks.beside(tmp_path / "head.ply") is None
    named().write(tmp_path / "head.landmarks.json")
    assert Landmarks.beside(tmp_path / "head.ply") == tmp_path / "head.landmarks.json"


def test_unnamed_points_match_by_order() -> None:
    p, _, names = Landmarks(torch.tensor(POINTS)).match(named())
    assert names == NAMES
    assert torch.equal(p, named().points)


def test_the_papers_landmarks_match(shared_data: Path) -> None:
    folder = shared_data / "landmarks3d"
    pair = [Landmarks.read(folder / f"nersemble_{i}.landmarks.json") for i in ("018", "032")]
    # 254 as published, four of which repeat another in both heads.
    assert len(pair[0].match(pair[1])[2]) == 250
    heads = [
        Landmarks.read(shared_data / "heads" / f"{name}.landmarks.json")
        for name in ("james", "status")
    ]
    assert len(heads[0].match(heads[1])[2]) == 137


# Bad input ----------------------------------------------------------------------------------


def test_a_name_must_mean_one_point(tmp_path: Path) -> None:
    with pytest.raises(LandmarkError, match="given twice: chin"):
        named(names=("nose", "chin", "chin", "ear", "crown"))
    (tmp_path / "x.json").write_text('{"points": {"a": [0, 0, 0], "a": [1, 1, 1]}}')
    with pytest.raises(LandmarkError, match="given twice: a"):
        Landmarks.read(tmp_path / "x.json")


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_points_must_be_finite(bad: float) -> None:
    with pytest.raises(LandmarkError, match=r"chin.*NaN or infinite"):
        named([POINTS[0], [0, bad, 0], *POINTS[2:]])


def test_too_few_pairs_are_named() -> None:
    other = named(POINTS, ("nose", "chin", "left ear", "x", "y"))
    with pytest.raises(LandmarkError, match=r"3 matched.*nose, chin, left ear.*at least 4"):
        named().match(other)
    with pytest.raises(LandmarkError, match="0 matched landmark pairs, expected"):
        named().match(named(names=tuple("vwxyz")))
    with pytest.raises(LandmarkError, match="5 source and 4 target"):
        named().match(Landmarks(torch.tensor(POINTS[:4])))


def test_one_point_cannot_go_to_two_places() -> None:
    doubled = named([POINTS[0], POINTS[0], *POINTS[2:]])
    for pair in ((named(), doubled), (doubled, named())):
        with pytest.raises(LandmarkError, match="nose, chin are one and the same point"):
            pair[0].match(pair[1])
    p, _, names = doubled.match(doubled)
    assert len(p) == len(names) == 4


def test_points_of_another_frame_are_named() -> None:
    low, high = torch.full((3,), -1.5), torch.full((3,), 1.5)
    named().check_near(low, high, "the head")
    millimetres = named([[1000 * x for x in point] for point in POINTS])
    with pytest.raises(LandmarkError, match=r"nose, chin.*far outside the head.*units"):
        millimetres.check_near(low, high, "the head")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.json", "{"),
        ("b.json", '{"points": 3}'),
        ("c.json", '{"points": {}}'),
        ("d.json", '{"points": {"a": [1, 2]}}'),
        ("e.csv", "a,b,c\n1,2\n3,4,5\n"),
        ("f.txt", ""),
        ("g.pp", "<PickedPoints><point x='1'/></PickedPoints>"),
        ("h.pp", "<PickedPoints>"),
        ("i.npy", "no numpy"),
        ("j.npz", "no numpy"),
        ("k.docx", "1 2 3"),
    ],
)
def test_damaged_files(tmp_path: Path, name: str, content: str) -> None:
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(ReadError) as caught:
        Landmarks.read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_pickles_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "x.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(ReadError, match="pickle"):
        Landmarks.read(tmp_path / "x.npy")


def test_missing_files_and_other_outputs(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="No such file"):
        Landmarks.read(tmp_path / "no.json")
    with pytest.raises(OptionError, match=r"written as \.json"):
        named().write(tmp_path / "x.csv")


def test_numbers_of_two_searches_are_not_taken_for_names() -> None:
    names = ("nose", *(f"auto_{i:04d}" for i in range(1, 6)))
    one, other = (torch.linspace(a, 0.9, 6) for a in (0.1, 0.2))
    source, same, strange = (Landmarks(torch.rand(6, 3), names, sure) for sure in (one, one, other))
    assert len(source.match(same)[2]) == 6
    with pytest.raises(LandmarkError, match=r"auto_0001.* different searches"):
        source.match(strange)
    # What somebody placed, or what no search has numbered, corresponds by its name.
    assert len(source.match(Landmarks(torch.rand(6, 3), names))[2]) == 6
    faces = tuple(f"face_{i}" for i in range(6))
    assert len(Landmarks(source.points, faces, one).match(Landmarks(same.points, faces, other))[2])
