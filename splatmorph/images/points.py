"""Landmarks of pictures: which coordinates a file speaks, and anchors on the frame."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from splatmorph.errors import LandmarkError, OptionError, ReadError
from splatmorph.images.canvas import Canvas
from splatmorph.io.arrays import read_npz
from splatmorph.io.reading import read_json, read_text, reading
from splatmorph.landmarks import Landmarks

CONVENTIONS = {
    "pixels-xy": "x to the right, y down; whole numbers are pixel centers, the first is (0, 0)",
    "pixels-rc": "row, column; whole numbers are pixel centers, the first is (0, 0)",
    "unit-xy": "x to the right, y down; each from -1 to 1 between the outer edges",
    "unit-rc": "row, column; each from -1 to 1 between the outer edges",
}
"""How a file may count coordinates. It is said by the file or by the caller, never guessed."""

OUTSIDE = 0.1
"""How far beyond the picture a landmark may lie, in longer sides: a chin that is cut off."""

SAME = 0.002
"""Pairs closer than this in both pictures, in longer sides, are one: nobody clicks finer."""


def read_points(path: str | Path, canvas: Canvas, convention: str | None = None) -> Landmarks:
    """Read the landmarks of the picture on ``canvas``.

    ``.tem`` (WebMorph) and ``.pts`` (iBUG, counted from 1) are pixels by definition. Every
    format of ``Landmarks.read`` is taken too, if it says its convention, by a line
    ``# convention: pixels-xy`` in text or a key ``"convention"`` in JSON and ``.npz``, or if
    ``convention`` is given. What the file says must agree with what is given.

    Returns:
        points in the plane, world units.

    Raises:
        ReadError: the file can't be read as landmarks.
        LandmarkError: no convention, or points beyond the picture.
        OptionError: an unknown convention.
    """
    path = Path(path)
    said: str | None
    if path.suffix.lower() in _FIXED:
        rows = _FIXED[path.suffix.lower()](path)
        said, found = "pixels-xy", _named_by(path, rows)
    else:
        said, found = _said(path), Landmarks.read(path, dim=2)
    points = _from_convention(found.points, canvas, _agreed(path, said, convention))
    return checked(Landmarks(points, found.names), canvas, str(path))


def read_pair(
    path: str | Path, source: Canvas, target: Canvas
) -> tuple[Landmarks, Landmarks] | None:
    """Both sides from one file ``{"points_0": …, "points_1": …}``, None if it isn't one.

    This is the paper's own format: rows (row, column) from -1 to 1.

    Raises:
        ReadError, LandmarkError: as ``read_points``.
    """
    path = Path(path)
    if path.suffix.lower() != ".json":
        return None
    stored = read_json(path)
    if not isinstance(stored, dict) or not {"points_0", "points_1"} <= stored.keys():
        return None
    sides = []
    for key, canvas in (("points_0", source), ("points_1", target)):
        with reading(path, f"pair of landmarks: '{key}' should hold rows of two numbers"):
            rows = np.asarray(stored[key], np.float64).reshape(-1, 2)
        found = _named_by(path, rows)
        points = _from_convention(found.points, canvas, "unit-rc")
        sides.append(checked(Landmarks(points), canvas, f"{path}, {key}"))
    return sides[0], sides[1]


def beside(picture: str | Path) -> Path | None:
    """The landmarks that belong to a picture: ``<stem>.landmarks.*``, ``.tem`` or ``.pts``."""
    picture = Path(picture)
    candidates = (picture.with_suffix(extension) for extension in _FIXED)
    return Landmarks.beside(picture) or next((c for c in candidates if c.is_file()), None)


def with_anchors(
    source: Landmarks, target: Landmarks, canvases: tuple[Canvas, Canvas], per_side: int
) -> tuple[Landmarks, Landmarks]:
    """The matched pairs, ``merged``, and anchors: points of the border that stay where they are.

    ``per_side`` steps a side: 1 anchors the four corners, 0 nothing. Between frames of
    different aspect the corners go to corners, so the picture is stretched.
    """
    source, target = merged(source, target)
    p, q, names = source.match(target)
    if per_side == 0:
        return Landmarks(p, names), Landmarks(q, names)
    anchors = [canvas.border(per_side) for canvas in canvases]
    names += tuple(f"anchor_{i}" for i in range(len(anchors[0])))
    return (
        Landmarks(torch.cat([p, anchors[0]]), names),
        Landmarks(torch.cat([q, anchors[1]]), names),
    )


def merged(source: Landmarks, target: Landmarks) -> tuple[Landmarks, Landmarks]:
    """The common pairs; those that lie within ``SAME`` in both pictures made one, their mean.

    Annotations are rounded to pixels, and the lips of a closed mouth are one line: there two
    points of one picture fall together whose partners lie a pixel or two apart. No flow can part
    them. Pairs that lie apart in one picture only are left to ``Landmarks.match`` to refuse.

    Raises:
        LandmarkError: the sets don't match.
    """
    p, q, names = _paired(source, target)
    near = (torch.cdist(p, p) < 2 * SAME) & (torch.cdist(q, q) < 2 * SAME)
    count, group = connected_components(csr_array(near.numpy()), directed=False)
    share = torch.nn.functional.one_hot(torch.from_numpy(group).long(), count).T.to(p)
    share /= share.sum(1, keepdim=True)
    joint = tuple("+".join(names[i] for i in row.nonzero().flatten()) for row in share)
    return Landmarks(share @ p, joint), Landmarks(share @ q, joint)


def _paired(source: Landmarks, target: Landmarks) -> tuple[Tensor, Tensor, Sequence[str]]:
    if source.names is None or target.names is None:
        if len(source) != len(target):
            source.match(target)  # says what is wrong with the counts
        return source.points, target.points, [str(i) for i in range(len(source))]
    places = [{name: i for i, name in enumerate(names)} for names in (source.names, target.names)]
    common = [name for name in source.names if name in places[1]]
    if not common:
        source.match(target)  # says that no name is common
    p, q = (
        side.points[[place[name] for name in common]]
        for side, place in zip((source, target), places, strict=True)
    )
    return p, q, common


def checked(landmarks: Landmarks, canvas: Canvas, origin: str) -> Landmarks:
    """The landmarks, if they lie on the picture or close to it.

    Raises:
        LandmarkError: names the first that lie further out.
    """
    half = torch.tensor(canvas.half, dtype=torch.float64)
    far = ((landmarks.points.abs() - half) > 2 * OUTSIDE).any(dim=1).nonzero().flatten().tolist()
    if not far:
        return landmarks
    first = far[0]
    x, y = canvas.to_pixels(landmarks.points[first]).tolist()
    raise LandmarkError(
        f"{origin}: {len(far)} of {len(landmarks)} landmarks lie outside the picture, e.g. "
        f"{landmarks.names[first] if landmarks.names else f'number {first}'} at pixel "
        f"({x:.0f}, {y:.0f}) of {canvas.width}x{canvas.height}: check the convention "
        f"({', '.join(CONVENTIONS)}) and that the file belongs to this picture"
    )


def _from_convention(points: Tensor, canvas: Canvas, convention: str) -> Tensor:
    unit, order = convention.split("-")
    if order == "rc":
        points = points.flip(1)
    if unit == "pixels":
        return canvas.to_world(points + 0.5)
    size = torch.tensor([canvas.width, canvas.height], dtype=points.dtype)
    return canvas.to_world((points + 1) / 2 * size)


def _named_by(path: Path, rows: np.ndarray) -> Landmarks:
    try:
        return Landmarks(torch.from_numpy(rows))
    except LandmarkError as error:
        raise LandmarkError(f"{path}: {error}") from error


def _agreed(path: Path, said: str | None, given: str | None) -> str:
    if given is not None and given not in CONVENTIONS:
        raise OptionError(
            f"landmark convention '{given}' is unknown: choose one of {', '.join(CONVENTIONS)}"
        )
    if said is not None and said not in CONVENTIONS:
        raise ReadError(
            f"{path} says its convention is '{said:.40}', expected one of {', '.join(CONVENTIONS)}"
        )
    if said and given and said != given:
        raise LandmarkError(f"{path} says its convention is {said}, but {given} was given")
    if not said and not given:
        raise LandmarkError(
            f"{path} does not say what its coordinates mean: give the convention, one of "
            f"{', '.join(CONVENTIONS)}"
        )
    return said or given or ""


def _said(path: Path) -> str | None:
    suffix = path.suffix.lower()
    if suffix == ".json":
        stored = read_json(path)
        value = stored.get("convention") if isinstance(stored, dict) else None
        return None if value is None else str(value)
    if suffix in (".csv", ".txt"):
        found = re.search(r"^#[ \t]*convention:[ \t]*(\S+)", read_text(path), re.MULTILINE)
        return found[1] if found else None
    if suffix == ".npz" and path.is_file():
        stored = read_npz(path, ["convention"], "landmark file")
        return str(stored["convention"]) if "convention" in stored else None
    return None


def _read_tem(path: Path) -> np.ndarray:
    rows = read_text(path).split("\n")
    with reading(path, "template, whose first line is the number of points"):
        count = int(rows[0])
    return _numbers(path, rows[1 : count + 1], count)


def _read_pts(path: Path) -> np.ndarray:
    head, opened, rest = read_text(path).partition("{")
    points, closed, _ = rest.partition("}")
    found = re.search(r"n_points:\s*(\d{1,9})\s", head)
    if not (found and opened and closed):
        raise ReadError(f"{path} is no .pts file: expected 'n_points: N' and points in braces")
    rows = [row for row in points.split("\n") if row.strip()]
    # The annotations of 300-W were made in MATLAB, where the first pixel is (1, 1).
    return _numbers(path, rows, int(found[1])) - 1


_FIXED = {".tem": _read_tem, ".pts": _read_pts}


def _numbers(path: Path, rows: Sequence[str], count: int) -> np.ndarray:
    with reading(path, "file of points, a line each"):
        values = [[float(cell) for cell in row.split()] for row in rows]
    if len(values) != count or any(len(row) != 2 for row in values):
        raise ReadError(
            f"{path} announces {count} points, expected as many lines of two numbers, "
            f"found {sum(len(row) == 2 for row in values)}"
        )
    return np.array(values).reshape(-1, 2)
