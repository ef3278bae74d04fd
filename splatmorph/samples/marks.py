"""Landmarks: the same names on every person, from the parameters that shape the face.

Each mark is a point of a chart that all persons share (a lid's edge, the dental arch, the jaw's
line, an angle round the head), carried onto the person's own surface.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch

from splatmorph.landmarks import Landmarks
from splatmorph.samples import hair
from splatmorph.samples.clothes import Garment
from splatmorph.samples.ear import ear_frame, outline
from splatmorph.samples.eyes import IRIS, brow_curve
from splatmorph.samples.head import EYEBALL, LID, Head
from splatmorph.samples.implicit import Array, Field, Point, column, length, project, trace
from splatmorph.samples.people import Person
from splatmorph.samples.splats import METRES

FRONT = (0.0, 0.0, -1.0)
AROUND = (
    ("front", 0),
    ("front_side", 40),
    ("side", 75),
    ("shoulder", 105),
    ("back_side", 145),
    ("back", 180),
)
SIDES = {"left": 1.0, "right": -1.0}


@dataclass(frozen=True)
class Sight:
    """How a point of the chart is carried onto a surface."""

    start: Point
    """Where to begin, mm."""
    surface: Field | None = None
    """What to meet; None: the start is the point."""
    towards: Point | None = None
    """Direction of a ray that first meets the surface; None: the closest point."""

    def point(self) -> Array:
        return resolve([self])[:, 0]


@dataclass(frozen=True)
class Marks:
    """A growing list of named points."""

    sights: dict[str, Sight] = field(default_factory=dict)
    """Name -> sight. A point of the left half is there twice, and mirrored when resolved."""

    def add(self, name: str, sight: Sight) -> None:
        """In the middle or, where it starts on the left, on both sides."""
        if abs(sight.start[0]) < 1e-3:
            self.sights[name] = sight
        else:
            self.sights.update({f"{name}_{side}": sight for side in SIDES})

    def points(self) -> Array:
        """(k, 3) in the order of the names, mm."""
        points = resolve(list(self.sights.values())).T
        for row, name in zip(points, self.sights, strict=True):
            row[0] *= SIDES.get(name.rpartition("_")[2], 0.0)
        return points


def resolve(sights: list[Sight]) -> Array:
    """(3, k) points, each surface asked once for all its sights."""
    points = np.array([sight.start for sight in sights], np.float32).T
    groups: dict[tuple[Field | None, bool], list[int]] = {}
    for i, sight in enumerate(sights):
        groups.setdefault((sight.surface, sight.towards is None), []).append(i)
    for (surface, closest), index in groups.items():
        if surface is None:
            continue
        if not closest:
            rays = np.array([sights[i].towards for i in index], np.float32).T
            points[:, index] = trace(surface, points[:, index], rays / length(rays))
        points[:, index] = project(surface, points[:, index], steps=6 if closest else 2)
    return points


def round_axis(surface: Field, azimuth: float, y: float) -> Sight:
    """The surface at a height and an azimuth, degrees from the front, round the head's axis."""
    turn = np.radians(azimuth)
    out = np.array([np.sin(turn), 0, np.cos(turn)])
    return Sight((180 * out[0], y, 180 * out[2] - 10), surface, tuple(-out))


def landmarks(person: Person) -> Landmarks:
    """All landmarks of the person, in metres."""
    head, marks = Head(person), Marks()
    mark_eyes(head, marks)
    mark_nose_and_face(head, marks)
    mark_mouth(head, marks)
    mark_jaw(head, marks)
    mark_ears(head, marks)
    mark_hair(head, marks)
    mark_neck(head, marks)
    points = marks.points().astype(np.float64) * METRES
    return Landmarks(torch.from_numpy(points), tuple(marks.sights))


def mark_eyes(head: Head, marks: Marks) -> None:
    a = head.person

    def on_lid(u: float, upper: bool) -> Sight:
        x = u * a.eye_half_width
        bulge = 1 - u * u
        v = a.lid_upper * bulge * (1 - 0.14 * u) if upper else -a.lid_lower * bulge * (1 + 0.16 * u)
        y = v + a.eye_tilt * x + (0.5 if upper else -0.5)
        z = np.sqrt(max((EYEBALL + LID) ** 2 - x * x - y * y, 4.0))
        return Sight((x + a.eye_x, y, z + a.eye_z), head)

    marks.add("eye_inner", on_lid(-0.98, True))
    marks.add("eye_outer", on_lid(0.98, True))
    for name, u in (("inner", -0.5), ("middle", 0.0), ("outer", 0.5)):
        marks.add(f"lid_upper_{name}", on_lid(u, True))
        marks.add(f"lid_lower_{name}", on_lid(u, False))

    def on_ball(x: float, y: float) -> Sight:
        return Sight((x + a.eye_x, y, float(np.sqrt(EYEBALL**2 - x * x - y * y)) + a.eye_z))

    marks.add("pupil", on_ball(-0.25, 0.2))
    marks.add("iris_inner", on_ball(-IRIS, 0))
    marks.add("iris_outer", on_ball(IRIS - 0.5, 0))
    for name, (x, y) in {
        "lid_crease": (0, a.lid_upper + 5.0),
        "under_eye_inner": (-9, -11),
        "under_eye": (3, -13),
    }.items():
        marks.add(name, Sight((a.eye_x + x, y, 160), head, FRONT))
    for name, t in (("inner", 0.02), ("arch", 0.55), ("middle", 0.3), ("outer", 0.97)):
        along, up = brow_curve(head, np.array(t, np.float32))
        marks.add(f"brow_{name}", Sight((float(along), float(up), 160), head, FRONT))


def mark_nose_and_face(head: Head, marks: Marks) -> None:
    a = head.person
    _, y, z = a.nose_tip
    wing = a.nostril_x + a.nostril_radius * 0.6
    for name, point in {
        "glabella": (0, 18),
        "nasion": (0, 7),
        "nose_bridge": (0, y * 0.45),
        "nose_side": (a.bridge_radius + 4, y * 0.5),
        "nose_tip": (0, y),
        "nose_wing": (wing, y - 3),
        "nose_wing_root": (wing + 3.5, y - 1),
        "nostril": (a.nostril_x * 0.6, y - 7),
        "cheekbone": (a.cheekbone[0], a.cheekbone[1]),
        "cheekbone_inner": (a.cheekbone[0] * 0.6, a.cheekbone[1] - 3),
        "cheek": (37, (y + a.mouth_y) / 2),
        "cheek_fold": (a.nostril_x + 15, (y + a.mouth_y) / 2),
        "forehead": (0, 42),
        "forehead_side": (30, 40),
        "forehead_inner": (16, 32),
        "forehead_top": (0, 58),
        "forehead_top_side": (24, 56),
        "cheek_high": (30, a.cheekbone[1] - 8),
        "cheek_low": (38, a.mouth_y - 4),
        "cheek_front": (20, a.cheekbone[1] - 3),
        "chin_edge": (16, (a.mouth_y + a.chin[1]) / 2),
    }.items():
        marks.add(name, Sight((*point, 180), head, FRONT))
    marks.add("nose_base", Sight((0, y - 15, z - 19), head))
    marks.add("temple", round_axis(head, 58, 24))
    marks.add("temple_back", round_axis(head, 76, 12))
    marks.add("cheek_side", round_axis(head, 66, -48))
    marks.add("cheekbone_outer", round_axis(head, 62, a.cheekbone[1] + 4))


def mark_mouth(head: Head, marks: Marks) -> None:
    a = head.person
    w, up, low = a.mouth_half_width, a.lip_upper, a.lip_lower

    def at(x: float, y: float) -> Sight:
        lift = a.smile * (x / w) ** 2
        return Sight((x, a.mouth_y + y + lift, 180), head, FRONT)

    def thin(x: float) -> float:
        return float(np.sqrt(max(1 - 0.92 * (x / w) ** 2, 0.06)))

    marks.add("mouth_corner", at(w * 0.97, 0))
    marks.add("lip_upper_bow", at(0, up * 0.88))
    marks.add("lip_upper_peak", at(6.5, up * 1.2))
    marks.add("lip_upper_side", at(w * 0.6, up * 1.1 * thin(w * 0.6)))
    marks.add("lip_upper_center", at(0, up * 0.45))
    marks.add("lip_parting", at(0, 0))
    marks.add("lip_parting_side", at(w * 0.5, 0))
    marks.add("lip_lower_center", at(0, -low * 0.5))
    marks.add("lip_lower_edge", at(0, -low * 1.08))
    marks.add("lip_lower_side", at(w * 0.55, -low * 1.08 * thin(w * 0.55)))
    marks.add("lip_lower_fold", at(0, -low - 8))


def mark_jaw(head: Head, marks: Marks) -> None:
    a = head.person
    _, y, z = a.chin
    marks.add("chin", Sight((0, y + 2, 180), head, FRONT))
    marks.add("chin_side", Sight((a.chin_radii[0] + 4, y + 5, 180), head, FRONT))
    marks.add("chin_bottom", Sight((0, y - 60, z - 4), head, (0, 1, 0)))
    marks.add("chin_under", Sight((0, y - 60, z - 28), head, (0, 1, 0)))
    gonion = np.array([a.jaw_half_width, a.jaw_y, 12])
    corner = np.array([a.chin_radii[0], y + 3, z - 6])
    out = np.array([0.75, -0.66, 0.0])
    for name, t in (("angle", 0.0), ("back", 0.3), ("middle", 0.6), ("front", 0.88)):
        core = gonion + t * (corner - gonion) + out * a.jaw_radius * (1 - 0.2 * t)
        marks.add(f"jaw_{name}", Sight(tuple(core), head))


def mark_ears(head: Head, marks: Marks) -> None:
    center, axes = ear_frame(head.person)
    half = head.person.ear_height / 2

    def on_ear(out: float, up: float, back: float) -> Sight:
        local = column((out, up, back)) * half
        return Sight(tuple((center + axes.T @ local)[:, 0]), head)

    for name, angle in (("front", 25), ("top", 85), ("back_top", 135), ("back", 180), ("low", 225)):
        up, back = outline(np.radians(angle))
        marks.add(f"ear_{name}", on_ear(0.16, 0.94 * up, 0.94 * back))
    marks.add("ear_lobe", on_ear(0.08, -1.02, -0.02))
    marks.add("ear_hollow", on_ear(0.0, -0.14, -0.08))
    marks.add("ear_tragus", on_ear(0.14, -0.22, -0.43))


def mark_hair(head: Head, marks: Marks) -> None:
    a = head.person
    angles, heights = np.array(a.hairline).T
    for name, azimuth in (("middle", 0), ("front", 25), ("side", 45), ("temple", 62)):
        y = float(np.interp(azimuth, angles, heights))
        marks.add(f"hairline_{name}", round_axis(head, azimuth, y))
    for name, azimuth in (("neck", 180), ("behind_ear", 125)):
        y = float(np.interp(azimuth, angles, heights)) + 6
        marks.add(f"hairline_{name}", round_axis(head, azimuth, y))

    bald = hair.scalp(head)
    tall = hair.swept_height if a.bun else hair.cropped_height

    def outer(p: Array) -> Array:
        return bald(p) - 0.8 * tall(head, p)

    for name, out in {
        "front": (0, 1.0, 0.75),
        "crown": (0, 1, 0.1),
        "crown_front": (0, 1, 0.42),
        "crown_side": (0.45, 1, 0.1),
        "crown_flank": (0.9, 1, 0.0),
        "front_side": (0.35, 1, 0.6),
        "front_flank": (0.75, 1, 0.5),
        "side": (1, 0.45, -0.15),
        "side_front": (1, 0.5, 0.3),
        "side_back": (1, 0.3, -0.6),
        "back_side": (0.6, 0.35, -1),
        "back_top": (0, 0.7, -1),
        "back_flank": (0.7, 0.9, -0.8),
        "back": (0, 0.25, -1),
        "back_low": (0, -0.25, -1),
        "back_low_side": (0.7, -0.2, -0.9),
    }.items():
        direction = np.array(out) / np.linalg.norm(out)
        start = direction * 190 + np.array([0, 30, -10])
        marks.add(f"hair_{name}", Sight(tuple(start), outer, tuple(-direction)))
    mark_whorl(head, outer, marks)


def mark_whorl(head: Head, outer: Field, marks: Marks) -> None:
    """Where hair is gathered: a bun rises from there, or short hair turns round it."""
    axis = hair.BUN_AXIS[:, 0]
    right, ahead = np.array([1.0, 0, 0]), np.array([0, 0.6, 0.8])
    center = np.array(hair.BUN_CENTER)
    whorl = Sight(tuple(center + 60 * axis), outer, tuple(-axis)).point()
    surface: Field
    if head.person.bun:
        middle, surface, belly, foot = center, hair.bun, 30.0, 29.0
        top = center + axis * hair.BUN_RADII[1]
    else:
        middle, surface, belly, foot = whorl, outer, 16.0, 25.0
        top = whorl + 4 * axis
    marks.add("whorl_top", Sight(tuple(top)))
    for name, out in (("", right), ("_front", ahead), ("_back", -ahead)):
        marks.add(f"whorl_belly{name}", Sight(tuple(middle + belly * out), surface))
        marks.add(f"whorl_foot{name}", Sight(tuple(whorl + foot * out), outer))


def mark_neck(head: Head, marks: Marks) -> None:
    a = head.person
    garment = Garment(head)
    rows = {
        "neck": -126.0,
        "collar": a.collar_y - 4,
        "collar_fold": a.collar_y - 15,
        "chest": (a.collar_y - 15 - 199) / 2,
        "hem": -199.0,
    }
    for row, y in rows.items():
        surface = head if row == "neck" else garment
        for name, azimuth in AROUND:
            behind = azimuth > 90 and row.startswith("collar")
            height = y + 2 * a.collar_lift * behind
            marks.add(f"{row}_{name}", round_axis(surface, azimuth, height))
    marks.add("base", Sight((0, -260, -20), garment, (0, 1, 0)))
