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
from splatmorph.samples.implicit import Array, Field, column, project, trace
from splatmorph.samples.people import Person
from splatmorph.samples.splats import METRES

FRONT = (0.0, 0.0, -1.0)
AROUND = (("front", 0), ("front_side", 40), ("side", 75), ("shoulder", 105), ("back_side", 145))
SIDES = {"left": 1.0, "right": -1.0}


@dataclass
class Marks:
    """A growing list of named points in millimetres."""

    points: dict[str, Array] = field(default_factory=dict)

    def add(self, name: str, p: Array) -> None:
        """One point (3, 1) in the middle of the body."""
        self.points[name] = p[:, 0]

    def both(self, name: str, p: Array) -> None:
        """A point of the left half, and its mirror image."""
        for side, sign in SIDES.items():
            self.points[f"{name}_{side}"] = p[:, 0] * np.array([sign, 1, 1], np.float32)

    def place(self, name: str, p: Array) -> None:
        """In the middle or on both sides, by where the point lies."""
        if abs(float(p[0, 0])) < 1e-3:
            self.add(name, p)
        else:
            self.both(name, p)


def seen_from(surface: Field, start: tuple[float, ...], towards: tuple[float, ...]) -> Array:
    """Where a ray first meets the surface, (3, 1)."""
    direction = column(towards) / np.linalg.norm(towards)
    hit = trace(surface, column(start), direction.astype(np.float32))
    return project(surface, hit, steps=2)


def round_axis(surface: Field, azimuth: float, y: float) -> Array:
    """The surface at a height and an azimuth, degrees from the front, round the head's axis."""
    turn = np.radians(azimuth)
    out = np.array([np.sin(turn), 0, np.cos(turn)])
    start = out * 180 + np.array([0, y, -10])
    return seen_from(surface, tuple(start), tuple(-out))


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
    points = np.stack(list(marks.points.values())).astype(np.float64) * METRES
    return Landmarks(torch.from_numpy(points), tuple(marks.points))


def mark_eyes(head: Head, marks: Marks) -> None:
    a = head.person
    center = column((a.eye_x, 0, a.eye_z))

    def on_lid(u: float, upper: bool) -> Array:
        x = u * a.eye_half_width
        bulge = 1 - u * u
        v = a.lid_upper * bulge * (1 - 0.14 * u) if upper else -a.lid_lower * bulge * (1 + 0.16 * u)
        y = v + a.eye_tilt * x + (0.5 if upper else -0.5)
        z = np.sqrt(max((EYEBALL + LID) ** 2 - x * x - y * y, 4.0))
        return project(head, column((x, y, z)) + center)

    marks.both("eye_inner", on_lid(-0.98, True))
    marks.both("eye_outer", on_lid(0.98, True))
    for name, u in (("inner", -0.5), ("middle", 0.0), ("outer", 0.5)):
        marks.both(f"lid_upper_{name}", on_lid(u, True))
        marks.both(f"lid_lower_{name}", on_lid(u, False))

    def on_ball(x: float, y: float) -> Array:
        return column((x, y, np.sqrt(EYEBALL**2 - x * x - y * y))) + center

    marks.both("pupil", on_ball(-0.25, 0.2))
    marks.both("iris_inner", on_ball(-IRIS, 0))
    marks.both("iris_outer", on_ball(IRIS - 0.5, 0))
    for name, (x, y) in {
        "lid_crease": (0, a.lid_upper + 5.0),
        "under_eye_inner": (-9, -11),
        "under_eye": (3, -13),
    }.items():
        marks.both(name, seen_from(head, (a.eye_x + x, y, 160), FRONT))
    for name, t in (("inner", 0.02), ("arch", 0.55), ("middle", 0.3), ("outer", 0.97)):
        along, up = brow_curve(head, np.array(t, np.float32))
        marks.both(f"brow_{name}", seen_from(head, (float(along), float(up), 160), FRONT))


def mark_nose_and_face(head: Head, marks: Marks) -> None:
    a = head.person
    _, y, _ = a.nose_tip
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
        marks.place(name, seen_from(head, (*point, 180), FRONT))
    marks.add("nose_base", seen_from(head, (0, y - 9.5, 160), (0, 0.25, -1)))
    marks.both("temple", round_axis(head, 58, 24))
    marks.both("temple_back", round_axis(head, 76, 12))
    marks.both("cheek_side", round_axis(head, 66, -48))
    marks.both("cheekbone_outer", round_axis(head, 62, a.cheekbone[1] + 4))


def mark_mouth(head: Head, marks: Marks) -> None:
    a = head.person
    w, up, low = a.mouth_half_width, a.lip_upper, a.lip_lower

    def at(x: float, y: float) -> Array:
        lift = a.smile * (x / w) ** 2
        return seen_from(head, (x, a.mouth_y + y + lift, 180), FRONT)

    def thin(x: float) -> float:
        return float(np.sqrt(max(1 - 0.92 * (x / w) ** 2, 0.06)))

    marks.both("mouth_corner", at(w * 0.97, 0))
    marks.add("lip_upper_bow", at(0, up * 0.88))
    marks.both("lip_upper_peak", at(6.5, up * 1.2))
    marks.both("lip_upper_side", at(w * 0.6, up * 1.1 * thin(w * 0.6)))
    marks.add("lip_upper_center", at(0, up * 0.45))
    marks.add("lip_parting", at(0, 0))
    marks.both("lip_parting_side", at(w * 0.5, 0))
    marks.add("lip_lower_center", at(0, -low * 0.5))
    marks.add("lip_lower_edge", at(0, -low * 1.08))
    marks.both("lip_lower_side", at(w * 0.55, -low * 1.08 * thin(w * 0.55)))
    marks.add("lip_lower_fold", at(0, -low - 8))


def mark_jaw(head: Head, marks: Marks) -> None:
    a = head.person
    _, y, z = a.chin
    marks.add("chin", seen_from(head, (0, y + 2, 180), FRONT))
    marks.both("chin_side", seen_from(head, (a.chin_radii[0] + 4, y + 5, 180), FRONT))
    marks.add("chin_bottom", seen_from(head, (0, y - 60, z - 4), (0, 1, 0)))
    marks.add("chin_under", seen_from(head, (0, y - 60, z - 28), (0, 1, 0)))
    gonion = np.array([a.jaw_half_width, a.jaw_y, 12])
    corner = np.array([a.chin_radii[0], y + 3, z - 6])
    out = np.array([0.75, -0.66, 0.0])
    for name, t in (("angle", 0.0), ("back", 0.3), ("middle", 0.6), ("front", 0.88)):
        core = gonion + t * (corner - gonion) + out * a.jaw_radius * (1 - 0.2 * t)
        marks.both(f"jaw_{name}", project(head, column(tuple(core)), steps=6))
    marks.both("jaw_root", round_axis(head, 84, -48))


def mark_ears(head: Head, marks: Marks) -> None:
    center, axes = ear_frame(head.person)
    half = head.person.ear_height / 2

    def on_ear(out: float, up: float, back: float) -> Array:
        local = column((out, up, back)) * half
        return project(head, center + axes.T @ local, steps=4)

    for name, angle in (("front", 25), ("top", 85), ("back_top", 135), ("back", 180), ("low", 225)):
        up, back = outline(np.radians(angle))
        marks.both(f"ear_{name}", on_ear(0.16, 0.94 * up, 0.94 * back))
    marks.both("ear_lobe", on_ear(0.08, -1.02, -0.02))
    marks.both("ear_hollow", on_ear(0.0, -0.14, -0.08))
    marks.both("ear_tragus", on_ear(0.14, -0.22, -0.43))


def mark_hair(head: Head, marks: Marks) -> None:
    a = head.person
    angles, heights = np.array(a.hairline).T
    for name, azimuth in (("middle", 0), ("front", 25), ("side", 45), ("temple", 62)):
        y = float(np.interp(azimuth, angles, heights))
        marks.place(f"hairline_{name}", round_axis(head, azimuth, y))
    for name, azimuth in (("neck", 180), ("behind_ear", 125)):
        y = float(np.interp(azimuth, angles, heights)) + 6
        p = round_axis(head, azimuth, y)
        marks.place(f"hairline_{name}", p * column((float(azimuth != 180), 1, 1)))

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
        marks.place(f"hair_{name}", seen_from(outer, tuple(start), tuple(-direction)))
    mark_whorl(head, outer, marks)


def mark_whorl(head: Head, outer: Field, marks: Marks) -> None:
    """Where hair is gathered: a bun rises from there, or short hair turns round it."""
    axis = hair.BUN_AXIS
    right, ahead = column((1, 0, 0)), column((0.0, 0.6, 0.8))
    center = column(hair.BUN_CENTER)
    top = center + axis * hair.BUN_RADII[1]
    whorl = seen_from(outer, tuple((center + 60 * axis)[:, 0]), tuple(-axis[:, 0]))
    tall = head.person.bun
    belly = 0.96 * np.array(hair.BUN_RADII)
    marks.add("whorl_top", top if tall else whorl + 4.0 * axis)
    reach, rise = (float(belly[0]), center) if tall else (16.0, whorl)
    marks.both(
        "whorl_belly", rise + reach * right if tall else project(outer, rise + reach * right)
    )
    for name, sign in (("front", 1.0), ("back", -1.0)):
        p = rise + sign * reach * ahead * (0.92 if tall else 1.0)
        marks.add(f"whorl_belly_{name}", p if tall else project(outer, p))
    foot = 29.0 if tall else 25.0
    marks.both("whorl_foot", project(outer, whorl + foot * right, steps=5))
    marks.add("whorl_foot_front", project(outer, whorl + foot * ahead, steps=5))
    marks.add("whorl_foot_back", project(outer, whorl - foot * ahead, steps=5))


def mark_neck(head: Head, marks: Marks) -> None:
    a = head.person
    garment = Garment(head)
    for name, azimuth in AROUND:
        marks.place(f"neck_{name}", round_axis(head, azimuth, -126))
    marks.add("neck_back", round_axis(head, 180, -126) * column((0, 1, 1)))
    rows = {
        "collar": a.collar_y - 4,
        "collar_fold": a.collar_y - 15,
        "chest": (a.collar_y - 15 - 199) / 2,
        "hem": -199,
    }
    for row, y in rows.items():
        for name, azimuth in AROUND:
            back = 2 * a.collar_lift if azimuth > 90 and row.startswith("collar") else 0
            marks.place(f"{row}_{name}", round_axis(garment, azimuth, y + back))
        back = 2 * a.collar_lift if row.startswith("collar") else 0
        marks.add(f"{row}_back", round_axis(garment, 180, y + back) * column((0, 1, 1)))
    marks.add("base", seen_from(garment, (0, -260, -20), (0, 1, 0)))
