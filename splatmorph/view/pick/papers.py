"""The files of the picker: landmarks beside the inputs, what was there before, the autosave."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch

from splatmorph.errors import SplatmorphError, WriteError
from splatmorph.images import points as image_points
from splatmorph.images import read_points
from splatmorph.io import stem_of
from splatmorph.io.atomic import atomic_write, make_folder, write_json
from splatmorph.io.reading import read_json
from splatmorph.landmarks import Landmarks
from splatmorph.view.pick.book import Book, Place, Row
from splatmorph.view.pick.sides import PictureSide, SplatSide

SEARCHED = ("auto_", "face_")
"""How the names of landmarks begin that a search found."""

Sides = Sequence[SplatSide] | Sequence[PictureSide]


@dataclass
class Papers:
    """Where a book is kept."""

    sides: Sides
    folder: Path | None = None
    """Where landmarks are written; beside each input if not given."""
    written: set[Path] = field(default_factory=set)
    """What is ours already: it needs no backup."""
    set_aside: Path | None = None
    """Where an autosave went that could not be read."""

    def path(self, side: int) -> Path:
        """Where the landmarks of an input are written."""
        one = self.sides[side].path
        return (self.folder or one.parent) / f"{stem_of(one)}.landmarks.json"

    @property
    def autosave(self) -> Path:
        """Where every state of the book is kept until it is saved."""
        names = "-".join(stem_of(side.path) for side in self.sides)
        return self.path(0).with_name(f"{names}.landmarks.autosave.json")

    def load(self) -> tuple[Row, ...]:
        """The rows of the landmarks that lie beside the inputs, matched by name.

        What has no name is matched by order. Points that only one input has come alone.

        Raises:
            SplatmorphError: a file is there that can't be read.
        """
        found = [self._landmarks(side) for side in range(len(self.sides))]
        names: dict[str, None] = {}
        points: list[dict[str, tuple[tuple[float, ...], bool]]] = []
        for landmarks in found:
            if landmarks is None:
                points.append({})
                continue
            own = landmarks.names or tuple(f"p{i + 1}" for i in range(len(landmarks)))
            names |= dict.fromkeys(own)
            auto = landmarks.confidence is not None
            values = landmarks.points.tolist()
            points.append({name: (tuple(at), auto) for name, at in zip(own, values, strict=True)})
        rows = []
        for number, name in enumerate(names, start=1):
            there = [side.get(name) for side in points]
            places = tuple(None if one is None else Place(one[0]) for one in there)
            auto = name.startswith(SEARCHED) or all(one is None or one[1] for one in there)
            rows.append(Row(number, name, places, auto=auto))
        return tuple(rows)

    def _landmarks(self, side: int) -> Landmarks | None:
        one = self.sides[side]
        given = self.path(side)
        if isinstance(one, PictureSide):
            path = given if given.is_file() else image_points.beside(one.path)
            return None if path is None else read_points(path, one.picture.canvas)
        path = given if given.is_file() else Landmarks.beside(one.path)
        if path is None:
            return None
        read = Landmarks.read(path)
        offset = read.points.new_tensor(one.gaussians.offset)
        return Landmarks(read.points - offset, read.names, read.confidence)

    def restore(self, book: Book) -> bool:
        """Fill the book from the autosave, if one is there and belongs to these inputs.

        Another is set aside, since the next step is written in its place.

        Raises:
            WriteError: it can't be set aside.
        """
        path = self.autosave
        if not path.is_file():
            return False
        try:
            stored = read_json(path)
            rows = Book.rows_from(stored["rows"], len(self.sides), self.sides[0].dim)
        except (SplatmorphError, KeyError, TypeError, ValueError):
            self._back_up(path)
            self.set_aside = _backup_of(path)
            return False
        book.change(rows)
        return True

    def keep(self, book: Book) -> None:
        """Write the autosave.

        Raises:
            WriteError: it can't be written.
        """
        make_folder(self.autosave.parent)
        write_json(self.autosave, {"rows": book.to_json()})

    def save(self, book: Book) -> list[Path]:
        """Write the finished pairs that count, the same names on both sides of each.

        A file that was there before is copied to ``….bak`` first, once. The autosave goes.

        Raises:
            WriteError: a file can't be written.
        """
        paths = []
        for side in range(len(self.sides)):
            rows = [(row.name, at) for row in book.rows if (at := row.settled(side)) is not None]
            if not rows:
                continue
            path = self.path(side)
            make_folder(path.parent)
            self._back_up(path)
            self._write(path, side, dict(rows))
            self.written.add(path)
            paths.append(path)
        if paths:
            self.autosave.unlink(missing_ok=True)
        return paths

    def _back_up(self, path: Path) -> None:
        if path in self.written or not path.is_file():
            return
        backup = _backup_of(path)
        try:
            with atomic_write(backup) as partial:
                shutil.copyfile(path, partial)
        except OSError as error:
            raise WriteError(f"can't copy {path} to {backup}: {error.strerror}") from error

    def _write(self, path: Path, side: int, points: dict[str, tuple[float, ...]]) -> None:
        one = self.sides[side]
        values = torch.tensor(list(points.values()), dtype=torch.float64)
        if isinstance(one, PictureSide):
            pixels = one.picture.canvas.to_pixels(values) - 0.5
            named = dict(zip(points, pixels.tolist(), strict=True))
            write_json(path, {"convention": "pixels-xy", "points": named})
            return
        values = values + values.new_tensor(one.gaussians.offset)
        Landmarks(values, tuple(points)).write(path)


def _backup_of(path: Path) -> Path:
    return path.with_name(f"{path.name}.bak")
