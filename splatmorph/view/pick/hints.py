"""What the picker proposes: the next place to click, the next name, a pair's mirror image."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splatmorph.errors import OptionError
from splatmorph.io.reading import read_text
from splatmorph.view.pick.book import Row

Array = NDArray[np.float64]

TEMPLATES = {
    "face12": (
        "eye_outer_right eye_inner_right eye_inner_left eye_outer_left nasion nose_tip "
        "nose_wing_right nose_wing_left mouth_corner_right mouth_corner_left lip_lower_edge chin"
    ),
    "head": (
        "ear_tragus_right ear_lobe_right ear_top_right ear_tragus_left ear_lobe_left ear_top_left "
        "hairline_middle hair_crown chin_under jaw_angle_right jaw_angle_left neck_front "
        "neck_side_right neck_side_left shoulder_right shoulder_left hair_back"
    ),
    "bust": (
        "eye_outer_right eye_inner_right eye_inner_left eye_outer_left nasion nose_tip "
        "mouth_corner_right mouth_corner_left chin ear_tragus_right ear_tragus_left "
        "hairline_middle hair_crown hair_back jaw_angle_right jaw_angle_left neck_front "
        "collar_front shoulder_right shoulder_left"
    ),
}
"""What to click next, by name; left and right are the object's own."""
FEWEST_SIDED, FEWEST_MIDDLE = 2, 3
LEFT = re.compile(r"(^|[_\W])(left|right|l|r|L|R|Left|Right)(?=$|[_\W\d])")
OPPOSITE = {"left": "right", "right": "left", "l": "r", "r": "l"}


def template_names(template: str) -> tuple[str, ...]:
    """The names of one of ``TEMPLATES``, or of a file with a name a line.

    Raises:
        OptionError: neither; ReadError: the file can't be read.
    """
    if template in TEMPLATES:
        return tuple(TEMPLATES[template].split())
    path = Path(template)
    if not path.is_file():
        raise OptionError(
            f"template is {template!r}, expected {', '.join(TEMPLATES)} or a file of names"
        )
    lines = (line.strip() for line in read_text(path).splitlines())
    names = tuple(dict.fromkeys(line for line in lines if line and not line.startswith("#")))
    if not names:
        raise OptionError(f"{path} holds no name, expected one a line")
    return names


def mirrored_name(name: str) -> str | None:
    """The name with left and right exchanged; None where it has neither."""
    found = LEFT.search(name)
    if found is None:
        return None
    word = found[2]
    other = OPPOSITE[word.lower()]
    other = other.capitalize() if word[0].isupper() else other
    return name[: found.start(2)] + other + name[found.end(2) :]


@dataclass(frozen=True)
class Mirror:
    """A plane (a line, in pictures) that an object's halves are mirrored by."""

    point: Array
    normal: Array

    def __call__(self, point: Array) -> Array:
        """The mirror image of a point (dim,)."""
        return np.asarray(point - 2 * float((point - self.point) @ self.normal) * self.normal)

    @staticmethod
    def of(rows: Sequence[Row], side: int) -> Mirror | None:
        """The plane of what is clicked on one input; None where that doesn't tell.

        By features that are there left and right, else by those in the middle, which are those
        whose names say neither while others say one.
        """
        points = {row.name: np.array(at) for row in rows if (at := row.settled(side)) is not None}
        pairs = [
            (points[name], points[other])
            for name in points
            if (other := mirrored_name(name)) is not None and other in points and name < other
        ]
        if len(pairs) >= FEWEST_SIDED:
            across = np.array([(b - a) / np.linalg.norm(b - a) for a, b in pairs])
            # Each pair's direction with the sign of the first's.
            across *= np.sign(across @ across[0])[:, None]
            middle = np.mean([(a + b) / 2 for a, b in pairs], axis=0)
            return Mirror(middle, _unit(across.mean(0)))
        sided = any(mirrored_name(row.name) is not None for row in rows)
        middles = np.array([at for name, at in points.items() if mirrored_name(name) is None])
        if not sided or len(middles) < FEWEST_MIDDLE:
            return None
        around = middles - middles.mean(0)
        return Mirror(middles.mean(0), np.linalg.svd(around)[2][-1])


def emptiest(places: Array, taken: Array, residuals: Sequence[float | None]) -> Array | None:
    """The one of ``places`` (n, dim) that is farthest from all ``taken`` (k, dim).

    Distances count for more near pairs that the others miss: there is more to be told.
    """
    if not len(places):
        return None
    if not len(taken):
        middle = np.median(places, axis=0)
        return np.asarray(places[np.linalg.norm(places - middle, axis=1).argmin()])
    far = np.linalg.norm(places[:, None] - taken[None], axis=2)
    nearest = far.argmin(1)
    known = [value for value in residuals if value is not None]
    usual = float(np.median(known)) if known else 0.0
    weights = np.array([1.0 if v is None or not usual else np.sqrt(v / usual) for v in residuals])
    weights = np.clip(weights, 0.7, 2.0) if len(weights) == len(taken) else np.ones(len(taken))
    return np.asarray(places[(far.min(1) * weights[nearest]).argmax()])


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))
