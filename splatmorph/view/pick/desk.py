"""The desk: what the page asks for, answered from the book, the inputs and the flows between."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch

from renderer import Camera
from splatmorph.errors import OptionError, SplatmorphError
from splatmorph.registration.masks import Loop, Mask
from splatmorph.view.pick import hints
from splatmorph.view.pick.book import Book, Place, Row, numbers
from splatmorph.view.pick.guide import Guide
from splatmorph.view.pick.papers import Papers, Sides
from splatmorph.view.pick.sides import SplatSide, camera_from
from splatmorph.view.pick.sights import Seen, crossing, stand_apart

SEE_THROUGH = 0.03
"""Radii between the depths on a sight line from which a click should be made again from aside."""
MISSED = 0.03
"""Radii by which two sight lines may miss each other and mean one feature."""

Asked = Mapping[str, Any]
Answer = dict[str, Any]


@dataclass
class Desk:
    """One session of picking. Not for two threads at once."""

    sides: Sides
    papers: Papers
    names: Sequence[str] = ()
    """What to click, in order."""
    book: Book = field(init=False)
    guides: dict[int, tuple[tuple[Row, ...], Guide]] = field(default_factory=dict)
    """For each leg, and the rows that it was fitted to."""
    unsaved: bool = False

    def __post_init__(self) -> None:
        self.book = Book(len(self.sides), self.papers.load())
        self.unsaved = self.papers.restore(self.book)
        self.actions: Mapping[str, Callable[[Asked], Answer]] = {
            "pick": self._pick,
            "accept": self._accept,
            "remove": self._remove,
            "rename": self._rename,
            "toggle": self._toggle,
            "autos": self._autos,
            "undo": lambda _: self._travel(self.book.undo),
            "redo": lambda _: self._travel(self.book.redo),
            "mirror": self._mirror,
            "mask": self._mask,
            "save": self._save,
        }
        self.questions: Mapping[str, Callable[[Asked], Answer]] = {
            "settle": lambda _: {},
            "suggest": self._suggest,
            "hidden": self._hidden,
        }

    def answer(self, name: str, asked: Asked) -> Answer:
        """What became of an action or a question, with the state of all there is.

        Raises:
            SplatmorphError: it can't be done; nothing has changed.
            KeyError, TypeError, ValueError: the page asks for what makes no sense.
        """
        if name in self.questions:
            found = self.questions[name](asked)
            return found if name != "settle" else self.state(settled=True)
        before = self.book.rows
        found = self.actions[name](asked)
        if self.book.rows != before:
            self.unsaved = True
            self.papers.keep(self.book)
        return {**self.state(), **found}

    def state(self, *, settled: bool = False) -> Answer:
        """Rows and legs in JSON's types; ``settled`` fits flows that aren't up to date."""
        legs = range(len(self.sides) - 1)
        return {
            "rows": self.book.to_json(),
            "legs": [self._leg(leg, settled=settled) for leg in legs],
            "undo": len(self.book.past),
            "redo": len(self.book.future),
            "unsaved": self.unsaved,
            "next": next(iter(self._free_names()), None),
        }

    def _leg(self, leg: int, *, settled: bool) -> Answer:
        rows = self.pairs(leg)
        known = self.guides.get(leg)
        fresh = known is not None and known[0] == rows
        if not (settled or fresh):
            return {"fresh": False, "pairs": len(rows)}
        guide = self.guide(leg)
        judged = zip(rows, guide.residuals, strict=True)
        return {
            "fresh": True,
            "pairs": len(rows),
            "residuals": {row.id: value for row, value in judged if value is not None},
            "doubtful": [rows[i].id for i in sorted(guide.doubtful)],
            "rms": guide.rms,
            "ready": guide.flow is not None,
            "trouble": guide.trouble,
            "turn": guide.frame.rotation.tolist() if guide.flow is not None else None,
        }

    def pairs(self, leg: int) -> tuple[Row, ...]:
        """The finished pairs of a leg that count."""
        return tuple(row for row in self.book.rows if row.on and row.joins(leg))

    def guide(self, leg: int) -> Guide:
        """The flow of a leg as its pairs are now."""
        rows = self.pairs(leg)
        known = self.guides.get(leg)
        if known is not None and _same_points(known[0], rows, leg):
            self.guides[leg] = (rows, known[1])
            return known[1]
        dim = self.sides[0].dim
        p, q = (
            torch.tensor(
                [place.point for row in rows if (place := row.places[side]) is not None],
                dtype=torch.float64,
            ).reshape(-1, dim)
            for side in (leg, leg + 1)
        )
        one, other = self.sides[leg], self.sides[leg + 1]
        guide = Guide.of(p, q, (one.center, other.center), (one.radius, other.radius))
        self.guides[leg] = (rows, guide)
        return guide

    def begin(self, rows: Iterable[Row]) -> None:
        """Put further rows into the book, one step."""
        self.book.change([*self.book.rows, *rows])
        self.unsaved = True

    # Actions ----------------------------------------------------------------------------------

    def _pick(self, asked: Asked) -> Answer:
        """A click on one side: of a new feature, or of one that is there."""
        leg, end = self._leg_of(asked), _end(asked)
        cameras = [camera_from(one) for one in asked["cameras"]]
        side = self.sides[leg + end]
        if asked.get("point") is not None:
            point = numbers(asked["point"], side.dim)
            found = side.seen_at(np.array(point), cameras[end])
        else:
            found = side.seen(cameras[end], *numbers([asked["x"], asked["y"]], 2))
        if found is None:
            return {"said": "nothing is there to be clicked"}
        old = None if asked.get("row") is None else self.book.row(int(asked["row"]))
        row = old or self.book.new(self._free_names())
        place, said = self._placed(row.places[leg + end], found, side.radius)
        row = row.with_place(leg + end, place)
        partner = row.places[leg + 1 - end]
        if partner is None or partner.guess:
            row = row.with_place(leg + 1 - end, self._predicted(leg, end, place, cameras))
        self.book.put(row)
        return {"selected": row.id, "said": said[0], "again": said[1]}

    def _placed(
        self, old: Place | None, found: Seen, radius: float
    ) -> tuple[Place, tuple[str, bool]]:
        """The place that a click makes, triangulated with earlier ones from other sides; what
        there is to say, and whether the same feature should be clicked again."""
        before = () if old is None or old.guess else old.rays
        if stand_apart(found.ray, before):
            rays = (*before, found.ray)
            point, missed = crossing(rays)
            if missed <= MISSED * radius:
                said = f"placed by {len(rays)} views, which miss each other by {missed:.3g}"
                return Place(point, rays=rays), (said, False)
            said = f"the views miss each other by {missed:.3g}: the last click counts"
            return Place(found.point, rays=(found.ray,)), (said, True)
        place = Place(found.point, rays=(found.ray,))
        if found.spread > SEE_THROUGH * radius:
            return place, ("see-through here: turn the view and click the same feature again", True)
        return place, ("", False)

    def _predicted(self, leg: int, end: int, place: Place, cameras: Sequence[Camera]) -> Place:
        here, there = cameras[end], cameras[1 - end]
        dim = self.sides[0].dim
        turn = np.eye(2) if dim == 2 else there.viewmat[:3, :3].T @ here.viewmat[:3, :3]
        where = self.guide(leg).predict(np.array(place.point), end, turn)
        where = self.sides[leg + 1 - end].onto_surface(where, there)
        return Place(tuple(where.tolist()), guess=True)

    def _accept(self, asked: Asked) -> Answer:
        row = self._row(asked)
        for side, place in enumerate(row.places):
            if place is not None and place.guess:
                row = row.with_place(side, replace(place, guess=False))
        self.book.put(row)
        return {"selected": None}

    def _remove(self, asked: Asked) -> Answer:
        gone = self._row(asked)
        self.book.change(row for row in self.book.rows if row.id != gone.id)
        return {"selected": None}

    def _rename(self, asked: Asked) -> Answer:
        self.book.rename(self._row(asked), str(asked["name"]))
        return {}

    def _toggle(self, asked: Asked) -> Answer:
        row = self._row(asked)
        self.book.put(replace(row, on=not row.on))
        return {}

    def _autos(self, asked: Asked) -> Answer:
        on = bool(asked["on"])
        self.book.change(replace(row, on=on) if row.auto else row for row in self.book.rows)
        return {}

    def _travel(self, step: Callable[[], bool]) -> Answer:
        return {"selected": None, "said": "" if step() else "nothing more"}

    def _mirror(self, asked: Asked) -> Answer:
        """The mirror image of a pair, as a guess on both sides."""
        leg, row = self._leg_of(asked), self._row(asked)
        name = hints.mirrored_name(row.name)
        if name is None:
            raise OptionError(f"{row.name} says neither left nor right: name the side first")
        if not row.joins(leg):
            raise OptionError(f"{row.name} is no finished pair yet")
        if any(other.name == name for other in self.book.rows):
            raise OptionError(f"{name} is there already")
        mirrored = replace(self.book.new(), name=name)
        for side in (leg, leg + 1):
            mirror, place = hints.Mirror.of(self.book.rows, side), row.places[side]
            if mirror is None or place is None:
                raise OptionError(
                    f"nothing tells where {self.sides[side].path.name} is mirrored: expected two "
                    "features that are there left and right, or three in the middle"
                )
            image = self.sides[side].seen_from_outside(mirror(np.array(place.point)))
            mirrored = mirrored.with_place(side, Place(tuple(image.tolist()), guess=True))
        self.book.put(mirrored)
        return {"selected": mirrored.id}

    def _mask(self, asked: Asked) -> Answer:
        """One more loop of what registration leaves out of a side; without a polygon: none."""
        side = self.sides[self._leg_of(asked) + _end(asked)]
        if not isinstance(side, SplatSide):
            raise OptionError("masks are for splats")
        path = Mask.path_beside(side.path)
        if asked.get("polygon") is None:
            path.unlink(missing_ok=True)
            return {"said": "nothing is left out any more", "masked": None}
        camera = camera_from(asked["camera"])
        pixels = np.array([numbers(corner, 2) for corner in asked["polygon"]])
        slopes = (pixels - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]]
        # Coordinates of the file, from which those in memory may be shifted.
        viewmat = camera.viewmat.copy()
        viewmat[:3, 3] -= viewmat[:3, :3] @ np.asarray(side.gaussians.offset)
        before = Mask.read(path).loops if path.is_file() else ()
        mask = Mask((*before, Loop(viewmat, slopes)))
        left = len(mask.kept(side.gaussians))
        mask.write(path)
        out = len(side.gaussians) - left
        return {"said": f"{out:,} splats of {side.name} are left out: wrote {path.name}"}

    def _save(self, asked: Asked) -> Answer:
        written = self.papers.save(self.book)
        self.unsaved = self.unsaved and not written
        said = f"wrote {' and '.join(path.name for path in written)}"
        return {"said": said if written else "no finished pair to save"}

    # Questions --------------------------------------------------------------------------------

    def _suggest(self, asked: Asked) -> Answer:
        """Where on the source a further pair would tell most, in this view."""
        leg = self._leg_of(asked)
        camera = camera_from(asked["camera"])
        rows, guide = self.pairs(leg), self.guide(leg)
        points = [place.point for row in rows if (place := row.places[leg]) is not None]
        taken = np.array(points).reshape(len(points), self.sides[leg].dim)
        best = hints.emptiest(self.sides[leg].places(camera), taken, guide.residuals[: len(rows)])
        return {"point": None if best is None else best.tolist()}

    def _hidden(self, asked: Asked) -> Answer:
        """The rows whose mark on a side lies behind the surface."""
        number = self._leg_of(asked) + _end(asked)
        rows = [row for row in self.book.rows if row.places[number] is not None]
        points = [place.point for row in rows if (place := row.places[number]) is not None]
        behind = self.sides[number].hidden(points, camera_from(asked["camera"]))
        return {"hidden": [row.id for row, is_so in zip(rows, behind, strict=True) if is_so]}

    # What is asked about ----------------------------------------------------------------------

    def _row(self, asked: Asked) -> Row:
        return self.book.row(int(asked["row"]))

    def _leg_of(self, asked: Asked) -> int:
        leg = int(asked["leg"])
        if not 0 <= leg < len(self.sides) - 1:
            raise OptionError(f"leg is {leg}, expected 0 to {len(self.sides) - 2}")
        return leg

    def _free_names(self) -> list[str]:
        taken = {row.name for row in self.book.rows}
        return [name for name in self.names if name not in taken]

    def leave(self) -> str | None:
        """What became of unsaved pairs at the end, a line, or None where there are none."""
        if not self.unsaved:
            return None
        try:
            self.papers.keep(self.book)
        except SplatmorphError as error:
            return f"what was not saved is lost: {error}"
        return f"not saved: kept in {self.papers.autosave}, and taken up next time"


def _end(asked: Asked) -> int:
    end = int(asked["side"])
    if end not in (0, 1):
        raise OptionError(f"side is {end}, expected 0 or 1")
    return end


def _same_points(a: Sequence[Row], b: Sequence[Row], leg: int) -> bool:
    def points(rows: Sequence[Row]) -> list[Any]:
        return [
            [place.point for place in row.places[leg : leg + 2] if place is not None]
            for row in rows
        ]

    return points(a) == points(b)
