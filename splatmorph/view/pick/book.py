"""The book of pairs: which features were clicked where, and every step that led here."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from splatmorph.errors import OptionError

Point = tuple[float, ...]
MOST_STEPS = 500
"""Steps that can be undone."""
MOST_ROWS = 5000
LONGEST_NAME = 120


@dataclass(frozen=True)
class Ray:
    """The sight line of a click, world units."""

    origin: Point
    direction: Point
    """Unit vector."""


@dataclass(frozen=True)
class Place:
    """Where a feature is on one of the inputs."""

    point: Point
    guess: bool = False
    """Predicted, and not accepted yet."""
    rays: tuple[Ray, ...] = ()
    """The clicks that it comes from, each from another side."""


@dataclass(frozen=True)
class Row:
    """One feature on all inputs."""

    id: int
    name: str
    places: tuple[Place | None, ...]
    """One an input, in their order."""
    on: bool = True
    """Whether it counts."""
    auto: bool = False
    """Found by a search."""

    def joins(self, leg: int) -> bool:
        """Whether it is a finished pair of the inputs ``leg`` and ``leg + 1``."""
        return all(place is not None and not place.guess for place in self.places[leg : leg + 2])

    def settled(self, side: int) -> Point | None:
        """The point that is saved of input ``side``: that of a finished pair which counts."""
        place = self.places[side]
        legs = [leg for leg in (side - 1, side) if 0 <= leg < len(self.places) - 1]
        kept = self.on and place is not None and any(self.joins(leg) for leg in legs)
        return place.point if kept and place is not None else None

    def with_place(self, side: int, place: Place | None) -> Row:
        """The row with another place on one input."""
        places = (*self.places[:side], place, *self.places[side + 1 :])
        return replace(self, places=places)


@dataclass
class Book:
    """All rows, and the states before and after that undo and redo go to."""

    inputs: int
    rows: tuple[Row, ...] = ()
    past: list[tuple[Row, ...]] = field(default_factory=list)
    future: list[tuple[Row, ...]] = field(default_factory=list)

    def change(self, rows: Iterable[Row]) -> None:
        """Go to another state; the one before can be had back."""
        self.past = [*self.past[-MOST_STEPS:], self.rows]
        self.rows, self.future = tuple(rows), []
        if len(self.rows) > MOST_ROWS:
            raise OptionError(f"{len(self.rows)} features, expected at most {MOST_ROWS}")

    def undo(self) -> bool:
        """One step back; False where there is none."""
        return self._travel(self.past, self.future)

    def redo(self) -> bool:
        """One step forth; False where there is none."""
        return self._travel(self.future, self.past)

    def _travel(self, source: list[tuple[Row, ...]], target: list[tuple[Row, ...]]) -> bool:
        if not source:
            return False
        target.append(self.rows)
        self.rows = source.pop()
        return True

    def row(self, number: int) -> Row:
        """The row with that ``id``.

        Raises:
            OptionError: there is none.
        """
        for row in self.rows:
            if row.id == number:
                return row
        raise OptionError(f"there is no feature {number}")

    def put(self, row: Row) -> None:
        """One step: this row changed, or added."""
        others = [row if old.id == row.id else old for old in self.rows]
        self.change(others if any(old.id == row.id for old in self.rows) else [*others, row])

    def new(self, names: Sequence[str] = ()) -> Row:
        """A row that isn't in the book yet, called by the first of ``names`` that is free."""
        number = 1 + max((row.id for row in self._every()), default=0)
        taken = {row.name for row in self.rows}
        counted = (f"p{i}" for i in range(1, len(taken) + 2))
        name = next(one for one in (*names, *counted) if one not in taken)
        return Row(number, name, (None,) * self.inputs)

    def _every(self) -> Iterable[Row]:
        yield from self.rows
        for rows in (*self.past, *self.future):
            yield from rows

    def rename(self, row: Row, name: str) -> None:
        """One step: the row called ``name``.

        Raises:
            OptionError: no name, a long one, or one that another row has.
        """
        name = name.strip()
        if not name or len(name) > LONGEST_NAME or not name.isprintable():
            raise OptionError(f"a name has 1 to {LONGEST_NAME} printable characters")
        if any(other.name == name and other.id != row.id for other in self.rows):
            raise OptionError(f"another feature is called {name}")
        self.put(replace(row, name=name))

    def to_json(self) -> list[dict[str, Any]]:
        """The rows in JSON's types."""
        return [
            {
                "id": row.id,
                "name": row.name,
                "on": row.on,
                "auto": row.auto,
                "places": [None if place is None else _place_json(place) for place in row.places],
            }
            for row in self.rows
        ]

    @staticmethod
    def rows_from(stored: Any, inputs: int, dim: int) -> tuple[Row, ...]:
        """What ``to_json`` gave.

        Raises:
            ValueError, TypeError, KeyError: something else.
        """
        rows = tuple(
            Row(
                int(one["id"]),
                str(one["name"])[:LONGEST_NAME],
                tuple(None if p is None else _place_of(p, dim) for p in one["places"]),
                bool(one["on"]),
                bool(one["auto"]),
            )
            for one in stored
        )
        if any(len(row.places) != inputs for row in rows):
            raise ValueError(f"expected {inputs} places a feature")
        if len({row.id for row in rows}) < len(rows) or len({row.name for row in rows}) < len(rows):
            raise ValueError("a feature is there twice")
        return rows


def _place_json(place: Place) -> dict[str, Any]:
    rays = [[ray.origin, ray.direction] for ray in place.rays]
    return {"point": place.point, "guess": place.guess, "rays": rays}


def _place_of(stored: Mapping[str, Any], dim: int) -> Place:
    rays = tuple(Ray(numbers(o, 3), numbers(d, 3)) for o, d in stored["rays"])
    return Place(numbers(stored["point"], dim), bool(stored["guess"]), rays)


def numbers(stored: Any, count: int) -> Point:
    """``count`` finite numbers.

    Raises:
        ValueError, TypeError: something else.
    """
    found = tuple(float(value) for value in stored)
    if len(found) != count or not all(map(math.isfinite, found)):
        raise ValueError(f"expected {count} finite numbers")
    return found
