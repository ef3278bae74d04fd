"""Landmark files of other programs: the same points, whatever the file calls them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from splatmorph.errors import LandmarkError, ReadError
from splatmorph.landmarks import Landmarks

POINTS = [[0.5, 1.25, -3.0], [4.0, 5.5, 6.0], [7.0, 8.0, 9.75], [-1.0, 0.0, 2.0]]
NAMES = ("nose", "chin", "ear left", "brow")


def rows(pattern: str, mark: str = ".") -> str:
    lines = (
        pattern.format(*(str(x).replace(".", mark) for x in point), i=i, n=name)
        for i, (point, name) in enumerate(zip(POINTS, NAMES, strict=True))
    )
    return "\n".join(lines) + "\n"


COUNTED = ("0", "1", "2", "3")
TABLES = {
    "semicolons and decimal commas.csv": ("name;x;y;z\n" + rows("{n};{0};{1};{2}", ","), NAMES),
    "semicolons without a header.csv": (rows("{0};{1};{2}", ","), None),
    "tabs and decimal commas.tsv": (rows("{n}\t{0}\t{1}\t{2}", ","), NAMES),
    "blanks and decimal commas.txt": (rows("{0} {1}  {2}", ","), None),
    "pandas index.csv": (",x,y,z\n" + rows("{i},{0},{1},{2}"), COUNTED),
    "pandas names.csv": (",x,y,z\n" + rows("{n},{0},{1},{2}"), NAMES),
    "index.csv": ("index,x,y,z\n" + rows("{i},{0},{1},{2}"), COUNTED),
    "index without a header.txt": (rows("{i} {0} {1} {2}"), COUNTED),
    "names last.csv": ("X,Y,Z,Label\n" + rows("{0},{1},{2},{n}"), NAMES),
    "other columns.csv": ("id,x,y,z,vis\n" + rows("{n},{0},{1},{2},1"), NAMES),
    "empty cells at the end.csv": ("name,x,y,z,,\n" + rows("{n},{0},{1},{2},,"), NAMES),
    "count line.txt": ("4\n" + rows("{0} {1} {2}"), None),
    "quoted.csv": (rows('"{n}","{0}","{1}","{2}"'), NAMES),
    "points.xyz": (rows("{0} {1} {2}"), None),
    "comments.txt": ("# by hand\n// again\n" + rows("{0}, {1}, {2}"), None),
    "slicer.fcsv": (
        "# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n"
        "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
        + rows("vtk_{i},{0},{1},{2},0,0,0,1,1,1,0,{n},,"),
        NAMES,
    ),
}


def named(key: str) -> list[dict[str, object]]:
    return [{"name": name, key: point} for name, point in zip(NAMES, POINTS, strict=True)]


AXES = [
    {"name": name, **dict(zip("xyz", point, strict=True))}
    for name, point in zip(NAMES, POINTS, strict=True)
]
SLICER = {
    "@schema": "https://raw.githubusercontent.com/slicer/slicer/markups-schema-v1.0.3.json#",
    "markups": [
        {
            "type": "Fiducial",
            "coordinateSystem": "LPS",
            "controlPoints": [
                {"id": str(i), "label": name, "position": point, "positionStatus": "defined"}
                for i, (name, point) in enumerate(zip(NAMES, POINTS, strict=True))
            ]
            + [{"id": "9", "label": "unset", "positionStatus": "undefined"}],
        }
    ],
}
JSONS = {
    "axes.json": (AXES, NAMES),
    "position.json": (named("position"), NAMES),
    "blender.json": (named("co"), NAMES),
    "under points.json": ({"points": AXES}, NAMES),
    "objects by name.json": ({one["name"]: {"position": one["co"]} for one in named("co")}, NAMES),
    "axes of objects.json": (
        [{"label": n, "location": dict(zip("xyz", p, strict=True))}
         for n, p in zip(NAMES, POINTS, strict=True)],
        NAMES,
    ),
    "no names.json": ([{"co": point} for point in POINTS], None),
    "slicer.mrk.json": (SLICER, NAMES),
}  # fmt: skip


@pytest.mark.parametrize("name", [*TABLES, *JSONS])
def test_the_same_points_in_every_form(tmp_path: Path, name: str) -> None:
    if name in TABLES:
        text, names = TABLES[name]
    else:
        stored, names = JSONS[name]
        text = json.dumps(stored)
    (tmp_path / name).write_text(text)
    found = Landmarks.read(tmp_path / name)
    assert torch.equal(found.points, torch.tensor(POINTS, dtype=torch.float64))
    assert found.names == names


def test_a_count_line_of_pixels(tmp_path: Path) -> None:
    (tmp_path / "x.txt").write_text("3\n245 223\n200 220\n261 314\n")
    found = Landmarks.read(tmp_path / "x.txt", dim=2)
    assert found.points.tolist() == [[245, 223], [200, 220], [261, 314]]


def test_a_first_row_is_no_count_where_it_counts_something_else(tmp_path: Path) -> None:
    (tmp_path / "x.txt").write_text("7\n245 223\n200 220\n261 314\n")
    with pytest.raises(ReadError, match="the line '7'"):
        Landmarks.read(tmp_path / "x.txt", dim=2)


def test_slicers_file_is_found_beside_its_splat(tmp_path: Path) -> None:
    (tmp_path / "head.landmarks.mrk.json").write_text(json.dumps(SLICER))
    found = Landmarks.beside(tmp_path / "head.ply")
    assert found is not None
    assert Landmarks.read(found).names == NAMES


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("x.json", '{"a": "b"}', ["b", '"name": [x, y, z]']),
        ("x.json", "3", ["holds 3", '"position": [x, y, z]']),
        ("x.json", '[{"name": "a", "where": 3}]', ["where", '"position"']),
        ("x.json", "[[1, 2, [3]]]", ["expected"]),
        ("x.json", "[[1, 2, 3], [4, 5]]", ["2 numbers for point 2"]),
        ("x.csv", "name,x,y,z\na,1,2,3\nb,1,two,3\n", ["'b 1 two 3'", "name, x, y, z"]),
        ("x.csv", "a,1,2,3\nb,1,2\n", ["'b 1 2'"]),
        ("x.fcsv", "# columns = id,a,b\nv,1,2\n", ["x.fcsv"]),
        ("x.stl", "solid", [".fcsv", ".json"]),
    ],
)
def test_other_forms_are_refused_with_those_that_are_read(
    tmp_path: Path, name: str, text: str, words: list[str]
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ReadError) as caught:
        Landmarks.read(tmp_path / name)
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_a_name_given_twice_in_a_list(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text(json.dumps([{"name": "a", "co": p} for p in POINTS]))
    with pytest.raises(LandmarkError, match="twice: a;"):
        Landmarks.read(tmp_path / "x.json")
