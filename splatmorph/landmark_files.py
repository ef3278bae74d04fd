"""Files of landmarks as people have them: each kind of file becomes points and their names."""

from __future__ import annotations

import csv
import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from splatmorph.errors import LandmarkError, ReadError
from splatmorph.io.arrays import read_npy, read_npz
from splatmorph.io.reading import read_json, read_text

AXES = ("x", "y", "z")
NAMES = ("name", "label", "id", "landmark", "title", "index", "")
"""What a column or a key with the names is called; pandas gives its index no name."""
POSITIONS = ("position", "co", "point", "location", "coordinates", "coords", "xyz", "p")
"""What a key with the coordinates is called; ``co`` is Blender's."""

JSON_FORMS = (
    'expected {"name": [x, y, z], …}, a list [[x, y, z], …], or a list of objects such as '
    '{"name": …, "x": …, "y": …, "z": …} or {"name": …, "position": [x, y, z]}'
)
TABLE_FORMS = "expected a point a line: x, y, z or name, x, y, z, with or without a header"


class Parsed(NamedTuple):
    """What a file holds, not yet checked."""

    points: object
    names: Iterable[str] | None = None
    confidence: object = None
    """By name, or in the order of the points."""


def parsed(path: Path, dim: int) -> Parsed:
    """Points and names of a landmark file; the extension names the kind, see ``READERS``.

    Raises:
        ReadError: an extension that we don't read, or a form that we don't know.
        LandmarkError: a name given twice.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ReadError(
            f"{path} has an extension we don't read landmarks from; we read "
            f"{', '.join(sorted(READERS))}"
        )
    found = reader(path)
    if isinstance(found.points, list):
        _check_rows(found.points, path, dim)
    return _without_index(found, dim)


def given_twice(names: Iterable[str]) -> LandmarkError:
    """What to raise where a name means more than one point."""
    twice = sorted(name for name, times in Counter(names).items() if times > 1)
    shown = ", ".join(twice[:5]) + (f" and {len(twice) - 5} more" if len(twice) > 5 else "")
    return LandmarkError(f"landmark names given twice: {shown}; a name must mean one point")


def _check_rows(rows: list[Any], path: Path, dim: int) -> None:
    usual, _ = Counter(map(len, rows)).most_common(1)[0] if rows else (0, 0)
    odd = next((i for i, row in enumerate(rows) if len(row) != usual), None)
    if odd is not None:
        raise ReadError(
            f"{path} has {len(rows[odd])} numbers for point {odd + 1} and {usual} for most others, "
            f"expected {dim} for each"
        )


def _without_index(found: Parsed, dim: int) -> Parsed:
    """A column more than there are axes that counts 0, 1, 2 or 1, 2, 3 names the points."""
    if found.names is not None or not isinstance(found.points, list):
        return found
    rows = [row for row in found.points if isinstance(row, list) and len(row) == dim + 1]
    if len(rows) < max(1, len(found.points)) or not all(map(_is_number, (row[0] for row in rows))):
        return found
    counted = [float(row[0]) for row in rows]
    if counted not in ([first + i for i in range(len(rows))] for first in (0.0, 1.0)):
        return found
    return Parsed([row[1:] for row in rows], [f"{number:.0f}" for number in counted])


# JSON ---------------------------------------------------------------------------------------


def _read_json(path: Path) -> Parsed:
    stored = read_json(path, "landmark file", pairs=_no_twice)
    if isinstance(stored, dict) and "markups" in stored:
        return _slicer_markups(stored["markups"], path)
    confidence = None
    if isinstance(stored, dict) and {"points", "landmarks"} & stored.keys():
        confidence = stored.get("confidence")
        stored = stored["points" if "points" in stored else "landmarks"]
    if isinstance(stored, dict):
        rows = [_coordinates(value, path) for value in stored.values()]
        return Parsed(rows, list(stored), confidence)
    if not isinstance(stored, list):
        raise ReadError(f"{path} holds {_shown(stored)}, {JSON_FORMS}")
    rows = [_coordinates(value, path) for value in stored]
    return Parsed(rows, _names_of(stored), confidence)


def _coordinates(value: object, path: Path) -> list[Any]:
    """The numbers of one point: a list, or an object that holds them."""
    if isinstance(value, Mapping):
        lower = {str(key).lower(): one for key, one in value.items()}
        if "x" in lower and "y" in lower:
            return [lower[axis] for axis in AXES if axis in lower]
        for key in POSITIONS:
            if key in lower:
                return _coordinates(lower[key], path)
    numbers = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else []
    if not numbers or any(isinstance(one, (list, dict, str, bool)) for one in numbers):
        raise ReadError(f"{path} holds {_shown(value)} as a point, {JSON_FORMS}")
    return numbers


def _names_of(rows: list[Any]) -> list[str] | None:
    named = [row for row in rows if isinstance(row, Mapping)]
    keys = [key for key in NAMES if named and all(key in row for row in named)]
    if not keys or len(named) < len(rows):
        return None
    return [str(row[keys[0]]) for row in named]


def _slicer_markups(markups: Any, path: Path) -> Parsed:
    """3D Slicer's control points, in the frame that the file is in."""
    points = [
        point
        for markup in markups
        for point in markup.get("controlPoints", [])
        if point.get("positionStatus", "defined") == "defined"
    ]
    names = [str(point.get("label") or point.get("id") or i) for i, point in enumerate(points)]
    return Parsed([_coordinates(point, path) for point in points], names)


def _no_twice(pairs: list[tuple[str, object]]) -> dict[str, object]:
    named = dict(pairs)
    if len(named) < len(pairs):
        raise given_twice([name for name, _ in pairs])
    return named


def _shown(value: object) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:60]}…"


# Tables -------------------------------------------------------------------------------------


def _read_table(path: Path) -> Parsed:
    rows = _cells(read_text(path))
    if rows and len(rows[0]) == 1 and rows[0][0] == str(len(rows) - 1):
        rows = rows[1:]  # a first line that counts the others
    if not rows:
        return Parsed([])
    header = None if _is_number(rows[0][-1]) else [cell.lower() for cell in rows[0]]
    if header and len(rows[0]) > 1:
        rows = rows[1:]
    if header and {"x", "y"} <= set(header):
        columns = [header.index(axis) for axis in AXES if axis in header]
        named = [header.index(name) for name in NAMES if name in header]
        # Whatever stands left of x names the points too.
        label = named[0] if named else 0 if 0 not in columns else None
    else:
        # With a header that doesn't name the axes, or none, only words tell names from numbers.
        worded = header is not None or not all(_is_number(row[0]) for row in rows)
        label = 0 if worded else None
        columns = list(range(int(worded), max(map(len, rows))))
    points = [[_number(row, column, path) for column in columns] for row in rows]
    return Parsed(points, None if label is None else [row[label] for row in rows])


def _cells(text: str) -> list[list[str]]:
    """The rows of a table by its own separator: semicolon, tab, comma, else white space."""
    lines = [line for line in text.splitlines() if line.strip()]
    lines = [line for line in lines if not line.lstrip().startswith(("#", "//"))]
    separator = next((mark for mark in ";\t," if any(mark in line for line in lines)), None)
    if separator == "," and all(_decimal_commas(line) for line in lines if "," in line):
        separator = None
    if separator is None:
        rows = [line.split() for line in lines]
    else:
        rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)]
        # Spreadsheets close rows with empty cells.
        width = max((i + 1 for row in rows for i, cell in enumerate(row) if cell), default=0)
        rows = [row[:width] for row in rows]
    return [[re.sub(r"^([-+]?\d*),(\d+)", r"\1.\2", cell) for cell in row] for row in rows]


def _decimal_commas(line: str) -> bool:
    """Whether every comma stands between digits, in words that white space parts."""
    words = line.split()
    return len(words) > 1 and all(re.fullmatch(r"[^,]*|[-+]?\d*,\d+(e[-+]?\d+)?", w) for w in words)


def _number(row: list[str], column: int, path: Path) -> float:
    try:
        return float(row[column])
    except (IndexError, ValueError):
        line = _shown(" ".join(row))
        raise ReadError(f"{path} has the line '{line}', {TABLE_FORMS}") from None


def _is_number(text: object) -> bool:
    try:
        float(text)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return False
    return True


def _read_fiducials(path: Path) -> Parsed:
    """3D Slicer's older table: its columns stand in a comment."""
    text = read_text(path)
    said = re.search(r"#\s*columns\s*=\s*(.+)", text)
    columns = [name.strip() for name in (said[1] if said else "id,x,y,z").split(",")]
    rows = list(csv.reader(line for line in text.splitlines() if line and line[0] != "#"))
    label = columns.index("label" if "label" in columns else "id")
    places = [columns.index(axis) for axis in AXES]
    names = [row[label] or row[columns.index("id")] for row in rows]
    return Parsed([[_number(row, place, path) for place in places] for row in rows], names)


# Others -------------------------------------------------------------------------------------


def _read_numpy(path: Path) -> Parsed:
    if path.suffix.lower() == ".npy":
        return Parsed(read_npy(path, "landmark file"))
    stored = read_npz(path, what="landmark file")
    if not stored:
        raise ReadError(f"{path} holds no arrays, expected 'points' and, where named, 'names'")
    points = stored["points"] if "points" in stored else next(iter(stored.values()))
    names = stored.get("names")
    return Parsed(points, None if names is None else [str(name) for name in np.ravel(names)])


def _read_picked_points(path: Path) -> Parsed:
    text = read_text(path)
    if "<!ENTITY" in text:
        raise ReadError(f"{path} defines entities of its own, which no picked points need: refused")
    picked = [
        point
        for point in ElementTree.fromstring(text).iter("point")
        if point.get("active", "1") != "0"
    ]
    names = [point.get("name") or str(i) for i, point in enumerate(picked)]
    return Parsed([[float(point.attrib[axis]) for axis in AXES] for point in picked], names)


READERS: Mapping[str, Callable[[Path], Parsed]] = {
    ".json": _read_json,
    ".npy": _read_numpy,
    ".npz": _read_numpy,
    ".csv": _read_table,
    ".tsv": _read_table,
    ".txt": _read_table,
    ".xyz": _read_table,
    ".fcsv": _read_fiducials,
    ".pp": _read_picked_points,
}
"""By extension; 3D Slicer's markups are told from other JSON by what they hold."""
MARKUPS = ".mrk.json"
