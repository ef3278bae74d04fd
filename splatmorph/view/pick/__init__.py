"""The picker: click the same feature on two inputs, and see the morph at once."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from splatmorph.errors import OptionError
from splatmorph.landmarks import Landmarks
from splatmorph.registration import find_landmarks
from splatmorph.registration.masks import without_masked
from splatmorph.registration.search import OnStep
from splatmorph.runs.inputs import load_splat
from splatmorph.view.limits import MAX_SPLATS
from splatmorph.view.pick.book import Place, Row
from splatmorph.view.pick.desk import Desk
from splatmorph.view.pick.hints import template_names
from splatmorph.view.pick.papers import Papers, Sides
from splatmorph.view.pick.server import Server
from splatmorph.view.pick.sides import PICTURES, PictureSide, SplatSide

__all__ = ["Desk", "Server", "open_desk", "start"]

SEARCHES = ("auto", "face")


def open_desk(
    paths: Sequence[str | Path],
    *,
    folder: str | Path | None = None,
    template: str | None = None,
    up: str | None = None,
    max_splats: int = MAX_SPLATS,
) -> Desk:
    """Load two inputs or more, all splats or all pictures, and what was picked on them before.

    Args:
        paths: as ``load_splat`` takes them, or pictures.
        folder: where landmarks are written; beside each input if not given.
        template: names of what to click, as ``template_names`` takes it.
        up: the axis that is up in all of them; what each says if not given.
        max_splats: most splats of an input that the page shows.

    Raises:
        SplatmorphError: an input, its landmarks or the template can't be read.
    """
    found = [Path(path) for path in paths]
    if len(found) < 2:
        raise OptionError(f"{len(found)} input is given, expected two or more")
    if len({path.resolve() for path in found}) < len(found):
        raise OptionError("an input is given twice, and landmarks belong to one each")
    if max_splats < 2:
        raise OptionError(f"max_splats is {max_splats}, expected at least 2")
    names = template_names(template) if template else ()
    drawn = [path.suffix.lower() in PICTURES for path in found]
    sides: Sides
    if all(drawn):
        sides = [PictureSide(path) for path in found]
    elif any(drawn):
        raise OptionError("splats and pictures are mixed, expected one kind")
    else:
        sides = [SplatSide(load_splat(path), max_splats, up) for path in found]
    papers = Papers(sides, None if folder is None else Path(folder))
    if len({papers.path(side) for side in range(len(sides))}) < len(sides):
        raise OptionError("two inputs have one name and would share a landmark file: rename one")
    return Desk(sides, papers, names)


def start(desk: Desk, how: str, on_step: OnStep | None = None) -> str:
    """Begin with landmarks that a search finds, or with those of a file for the first input.

    Args:
        desk: whose book gets them, as one step.
        how: "auto" or "face", the methods of ``find_landmarks``; or a landmark file of the first
            input, whose points are then to be placed on the others.
        on_step: called with the progress of a search.

    Returns:
        What was found, a line.

    Raises:
        SplatmorphError: the search finds nothing, or the file can't be read.
    """
    sides = desk.sides
    taken = {row.name for row in desk.book.rows}
    if how not in SEARCHES:
        return _from_file(desk, Path(how), taken)
    if isinstance(sides[0], PictureSide):
        raise OptionError("only splats are searched; pictures are begun with a file")
    said = []
    number = desk.book.new().id
    rows: dict[str, Row] = {}
    splats = [
        without_masked(side.gaussians, side.path) for side in sides if isinstance(side, SplatSide)
    ]
    for leg, (one, other) in enumerate(pairwise(splats)):
        found = find_landmarks(one, other, how, on_step=on_step)
        said.append(str(found))
        for name, p, q in zip(
            found.source.names or (),
            found.source.points.tolist(),
            found.target.points.tolist(),
            strict=True,
        ):
            # Faces have the same points everywhere, those of surfaces are found for each pair.
            own = name if len(sides) == 2 or name.startswith("face_") else f"{name}_{leg + 1}"
            if own in taken:
                continue
            row = rows.get(own) or Row(number + len(rows), own, (None,) * len(sides), auto=True)
            row = row.with_place(leg, Place(tuple(p)))
            rows[own] = row.with_place(leg + 1, Place(tuple(q)))
    desk.begin(rows.values())
    return "; ".join(said)


def _from_file(desk: Desk, path: Path, taken: set[str]) -> str:
    side = desk.sides[0]
    if not path.is_file():
        raise OptionError(f"{path} is no file, and no search: expected {', '.join(SEARCHES)}")
    if isinstance(side, PictureSide):
        raise OptionError("pictures are begun with the landmarks that lie beside them")
    read = Landmarks.read(path)
    points = (read.points - read.points.new_tensor(side.gaussians.offset)).tolist()
    names = read.names or tuple(f"p{i + 1}" for i in range(len(read)))
    first = desk.book.new().id
    new = [(name, at) for name, at in zip(names, points, strict=True) if name not in taken]
    rows = [
        Row(first + i, name, (Place(tuple(at)), *(None for _ in desk.sides[1:])))
        for i, (name, at) in enumerate(new)
    ]
    desk.begin(rows)
    return f"{len(rows)} features to be placed, from {path}"
