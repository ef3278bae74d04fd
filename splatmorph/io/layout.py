"""The header of a PLY file: what the file promises, held against what it can hold."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatmorph.errors import ReadError
from splatmorph.io.reading import reading, require_file

LONGEST_HEADER = 1 << 20
MOST_PROPERTIES = 1000
LEAST_OF_TEXT = 2
"""Bytes of a number in an ascii file: a digit and what parts it from the next."""

TYPES = {
    name: code
    for code, names in {
        "i1": ("char", "int8"),
        "u1": ("uchar", "uint8"),
        "i2": ("short", "int16"),
        "u2": ("ushort", "uint16"),
        "i4": ("int", "int32"),
        "u4": ("uint", "uint32"),
        "f4": ("float", "float32"),
        "f8": ("double", "float64"),
    }.items()
    for name in names
}
ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class Element:
    """A kind of row."""

    name: str
    count: int
    fields: tuple[tuple[str, str], ...]
    """Name and type of each property, as numpy writes it; of a list the type of its length."""
    lists: bool
    """Whether any is a list, so that rows differ in length."""


@dataclass(frozen=True)
class Layout:
    """What a PLY header says."""

    order: str
    """The byte order as numpy writes it."""
    text: bool
    """Whether the rows are ascii."""
    elements: tuple[Element, ...]
    comments: tuple[str, ...]
    begin: int
    """Where the rows begin in the file."""


def read_layout(path: Path) -> Layout:
    """Read the header, and refuse promises that the file is too small to keep.

    Raises:
        ReadError: the file is missing, empty, truncated, or no PLY.
    """
    require_file(path)
    with reading(path, "PLY file", remedy="export it again"), path.open("rb") as stream:
        size = path.stat().st_size
        if size == 0:
            raise ReadError(f"{path} is empty, expected a PLY file: export or download it again")
        layout = _parsed(stream.read(LONGEST_HEADER))
        least = sum(_least(element, layout.text) for element in layout.elements)
        # The last number of a text needs nothing after it.
        if least > size - layout.begin + layout.text:
            raise ValueError(f"it ends too early (truncated), {least} bytes are promised")
        return layout


def _least(element: Element, text: bool) -> int:
    if element.count and not element.fields:
        raise ValueError(f"element {element.name} has {element.count} rows of no properties")
    sizes = [LEAST_OF_TEXT if text else np.dtype(code).itemsize for _, code in element.fields]
    return element.count * sum(sizes)


def _parsed(head: bytes) -> Layout:
    found = re.match(rb"ply[ \t]*(\r\n|\n|\r)", head)
    if found is None:
        raise ValueError("it does not start with 'ply'; is it another format?")
    newline = found[1]
    header, end, _ = head.partition(newline + b"end_header" + newline)
    if not end:
        raise ValueError("its header has no end")
    lines = header.decode("ascii", "replace").split(newline.decode())[1:]
    words = [line.split() for line in lines]
    formats = [line[1] for line in words if line[:1] == ["format"] and len(line) == 3]
    if len(formats) != 1 or formats[0] not in ORDERS:
        raise ValueError(f"its header names no format that we know ({', '.join(formats)})")
    comments = tuple(
        line.strip().removeprefix("comment").strip()
        for line, split in zip(lines, words, strict=True)
        if split[:1] == ["comment"]
    )
    begin = len(header) + len(end)
    return Layout(ORDERS[formats[0]], formats[0] == "ascii", _elements(words), comments, begin)


def _elements(lines: list[list[str]]) -> tuple[Element, ...]:
    made: list[Element] = []
    rows: list[list[list[str]]] = []
    for line in lines:
        if line[:1] == ["element"]:
            _, name, count = line
            if not (count.isdecimal() and len(count) < 16):
                raise ValueError(f"element {name} has {count} rows")
            made.append(Element(name, int(count), (), False))
            rows.append([])
        elif line[:1] == ["property"]:
            if not rows or len(rows[-1]) == MOST_PROPERTIES:
                raise ValueError("properties of no element, or too many of one")
            rows[-1].append(line[1:])
        elif line and line[0] not in ("format", "comment", "obj_info"):
            raise ValueError(f"its header has a line that begins with {line[0]!r}")
    elements = tuple(
        Element(one.name, one.count, _fields(row), any(line[0] == "list" for line in row))
        for one, row in zip(made, rows, strict=True)
    )
    _require_distinct([element.name for element in elements])
    return elements


def _fields(properties: list[list[str]]) -> tuple[tuple[str, str], ...]:
    fields = []
    for line in properties:
        known = [TYPES[name] for name in line[:-1] if name != "list"]
        if len(known) != (2 if line[0] == "list" else 1) or line.count("list") > 1:
            raise ValueError(f"its header has a property {' '.join(line)!r}")
        fields.append((line[-1], known[0]))
    _require_distinct([name for name, _ in fields])
    return tuple(fields)


def _require_distinct(names: list[str]) -> None:
    if len(set(names)) < len(names):
        raise ValueError("its header names something twice")
