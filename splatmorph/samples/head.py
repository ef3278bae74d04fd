"""The skin of a bust: skull, face and neck as one implicit solid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatmorph.samples.ear import ear
from splatmorph.samples.implicit import (
    Array,
    capsule,
    carve,
    column,
    ellipsoid,
    join,
    length,
    meet,
    mirrored,
    near,
    smoothstep,
    tube,
)
from splatmorph.samples.people import Person

EYEBALL = 15.0
"""Radius of an eyeball, mm."""
LID = 1.5
"""Thickness of an eyelid, mm."""


@dataclass(frozen=True)
class Head:
    """The solid of one person's skin. Calling it gives signed distances in mm."""

    person: Person

    def __call__(self, p: Array) -> Array:
        m = mirrored(p)
        d = self.skull(m)
        d = self.with_sockets(m, d)
        d = self.with_nose(m, d)
        d = self.with_mouth(m, d)
        d = self.with_lids(m, d)
        d = join(d, self.neck(m), 14)
        return self.with_ears(m, d) + self.person.age * wrinkles(p)

    def skull(self, m: Array) -> Array:
        """Cranium, face, cheekbones, brow and jaw."""
        a = self.person
        d = ellipsoid(m, (0, 33, -8), a.cranium)
        d = join(d, ellipsoid(m, (0, 36, a.forehead_z - 50), (52, 44, 50)), 24)
        d = join(d, ellipsoid(m, (0, -32, 22), a.face), 22)
        gonion = (a.jaw_half_width, a.jaw_y, 12)
        corner = (a.chin_radii[0], a.chin[1] + 3, a.chin[2] - 6)
        d = join(d, capsule(m, gonion, corner, a.jaw_radius, a.jaw_radius * 0.8), 24)
        root = (a.jaw_half_width + 6, -28, 2)
        d = join(d, capsule(m, root, gonion, a.jaw_radius - 2, a.jaw_radius), 28)
        d = join(d, ellipsoid(m, a.chin, a.chin_radii), 16)
        size = a.cheekbone_size
        d = join(d, ellipsoid(m, a.cheekbone, (size, size * 0.72, size)), 22)
        fill = 4 * a.cheek_fill
        d = join(d, ellipsoid(m, (36, -50, 58), (18 + fill, 24 + fill, 18 + fill)), 24)
        d = join(d, ellipsoid(m, (0, -86, 34), (34, 17, 38)), 20)
        d = join(d, ellipsoid(m, (a.eye_x + 17, 2, 56), (11, 18, 14)), 14)
        brow = [(4, 15.5, 84), (26, 23 - a.brow_drop, 84), (43, 17 - a.brow_drop, 70)]
        return join(d, tube(m, brow, (a.brow_ridge - 1, a.brow_ridge, a.brow_ridge - 1)), 16)

    def with_sockets(self, m: Array, d: Array) -> Array:
        """Hollows for the eyes and at the temples."""
        a = self.person
        socket = ellipsoid(m, (a.eye_x, -3, a.eye_z + 24), (19, 13.5, 15))
        d = carve(d, socket, 12)
        temple = ellipsoid(m, (88, 20, 46), (18, 26, 24))
        return carve(d, temple, 14)

    def with_nose(self, m: Array, d: Array) -> Array:
        a = self.person
        _, y, z = a.nose_tip
        r, tip, wing = a.bridge_radius, a.nose_tip_radius, a.nostril_radius

        def bridge(q: Array) -> Array:
            middle = (0, y * 0.45, (a.eye_z + 13 + z - tip) / 2 + a.bridge_bump)
            ridge = tube(q, [(0, 11, a.eye_z + 7), middle, (0, y + 2, z - tip)], (r + 1, r, r))
            return join(ridge, ellipsoid(q, (0, y + 9, z - 28), (a.nostril_x + 6, 24, 15)), 10)

        def base(q: Array) -> Array:
            n = ellipsoid(q, (0, y, z - tip), (tip, tip * 0.88, tip))
            side = ellipsoid(
                q, (a.nostril_x, y - 3, z - 16), (wing * 0.75, wing * 0.9, wing * 1.25)
            )
            n = join(n, side, 7)
            columella = capsule(q, (0, y - 6, z - 9), (0, y - 10, z - 24), 3.4, 4.5)
            return join(n, columella, 4)

        def nostril(q: Array) -> Array:
            center = (a.nostril_x * 0.55, y - 9.0, z - 14)
            return ellipsoid(q, center, (wing * 0.40, wing * 0.55, wing * 0.8))

        d = join(d, near(m, (0, y + 14, z - 24), 75, bridge), 5 + r)
        d = join(d, near(m, (0, y, z - 14), 50, base), 7)
        return carve(d, near(m, (0, y - 8, z - 14), 30, nostril), 2.5)

    def arch(self, x: Array) -> Array:
        """How far the row of teeth lies behind its front at ``x``."""
        return 0.0125 * x * x

    def mouth_frame(self, m: Array) -> Array:
        """Points in the frame of the mouth: the dental arch unbent, the smile straightened."""
        a = self.person
        lift = a.smile * (m[0] / a.mouth_half_width) ** 2
        z = m[2] - a.mouth_z + self.arch(m[0])
        return np.stack([m[0], m[1] - a.mouth_y - lift, z])

    def lips(self, m: Array) -> tuple[Array, Array]:
        """Signed distances of the upper and the lower lip."""
        a = self.person
        q = self.mouth_frame(m)
        w, up, low = a.mouth_half_width, a.lip_upper, a.lip_lower
        # Both lips thin out toward the corners: heights are measured in a widening frame.
        taper = np.sqrt(np.maximum(1 - 0.92 * (q[0] / w) ** 2, 0.06))
        bow = 0.22 * up * np.exp(-((q[0] / 3.2) ** 2)) - 0.16 * up * np.exp(
            -(((q[0] - 6.5) / 4) ** 2)
        )
        t = np.stack([q[0], (q[1] + np.where(q[1] > 0, bow, 0)) / taper, q[2]])
        upper = ellipsoid(t, (0, up * 0.48, 0.6), (w * 1.02, up * 0.62, 5.6)) * taper
        lower = ellipsoid(t, (0, -low * 0.50, 0.2), (w * 0.97, low * 0.60, 6.4)) * taper
        return upper, lower

    def with_mouth(self, m: Array, d: Array) -> Array:
        a = self.person
        y, z, w = a.mouth_y, a.mouth_z, a.mouth_half_width

        def details(q: Array, skin: Array) -> Array:
            frame = self.mouth_frame(q)
            muzzle = ellipsoid(frame, (0, -1, -12), (w + 14, 25, 15))
            skin = join(skin, muzzle, 14)
            groove = capsule(frame, (0, a.lip_upper + 2, 6.0), (0, a.lip_upper + 10, 5.0), 1.6, 1.2)
            skin = carve(skin, groove, 3.5)
            dip = ellipsoid(frame, (0, -a.lip_lower - 8, 7.5), (w * 0.6, 3.0, 4.0))
            skin = carve(skin, dip, 7)
            upper, lower = self.lips(q)
            skin = join(skin, upper, 2.2)
            skin = join(skin, lower, 2.2)
            parting = ellipsoid(frame, (0, 0, 6.5), (w * 0.90, 0.4, 5.0))
            return carve(skin, parting, 1.6)

        inside = np.flatnonzero(length(m - column((0, y, z - 8))) < 60)
        d[inside] = details(m[:, inside], d[inside])
        crease = tube(
            m,
            [
                (a.nostril_x + 9, a.nose_tip[1] + 1, z + 4),
                (a.nostril_x + 18, y + 16, z - 3),
                (w + 11, y, z - 12),
            ],
            (0.6, 1.0, 0.4),
        )
        return carve(d, crease + 2.4 - 3.6 * a.age, 6 + 2 * a.age)

    def lid_gap(self, q: Array) -> Array:
        """Signed distance to the opening between the lids, in the frame of the eye."""
        a = self.person
        u = q[0] / a.eye_half_width
        v = q[1] - a.eye_tilt * q[0]
        bulge = np.maximum(1 - u * u, -0.6)
        upper = v - a.lid_upper * bulge * (1 - 0.14 * u)
        lower = -v - a.lid_lower * bulge * (1 + 0.16 * u)
        slope = 1 + 0.35 * np.abs(u)
        return np.maximum(upper, lower) / slope

    def with_lids(self, m: Array, d: Array) -> Array:
        """Lids over the eyeballs, cut open along the almond of ``lid_gap``."""
        a = self.person
        center = column((a.eye_x, 0, a.eye_z))
        inside = np.flatnonzero(length(m - center) < 34)
        q = m[:, inside] - center
        skin = d[inside]
        ball = length(q) - EYEBALL
        upper = v_above(q, a.eye_tilt)
        lids = ball - LID - 0.5 * upper
        skin = join(skin, lids, 9.0)
        gap = self.lid_gap(q)
        crease = np.abs(q[1] - a.eye_tilt * q[0] - a.lid_upper * (1 - (q[0] / 17) ** 2) - 4.6)
        groove = np.maximum(crease - 0.3, np.abs(ball - LID - 2) - 1.6)
        skin = carve(skin, np.maximum(groove, np.abs(q[0]) - 15), 2.2 * a.lid_fold)
        opening = np.maximum(np.maximum(gap, -q[2]), -(ball + 1.5))
        d[inside] = carve(skin, opening, 1.0)
        return d

    def neck(self, m: Array) -> Array:
        a = self.person
        r = a.neck_radius
        front = 38
        d = capsule(m, (0, -50, front - r), (0, -200, front - 8 - r), r, r + 2)
        cord = capsule(m, (r * 0.85, -45, -16), (9, -170, front - 6), 6, 4)
        d = join(d, cord, 18)
        throat = ellipsoid(m, (0, -138, front - 4), (7, 12, 6 + 3 * a.throat))
        d = join(d, throat, 16)
        shoulder = capsule(m, (20, -152, -32), (90, -198, -30), 28, 30)
        d = join(d, shoulder, 45)
        d = join(d, ellipsoid(m, (0, -215, -18), (96, 62, 58)), 30)
        return meet(d, -m[1] - 205, 10)

    def with_ears(self, m: Array, d: Array) -> Array:
        body, hollow = ear(self.person, m)
        return carve(join(d, body, 5), hollow, 2)


def v_above(q: Array, tilt: float) -> Array:
    """1 over the upper lid, 0 over the lower one."""
    return smoothstep(-2, 3, q[1] - tilt * q[0])


def wrinkles(p: Array) -> Array:
    """Depth in mm of the lines that age leaves on a forehead and beside the eyes."""
    x, y, z = p
    wave = y - 4 * np.cos(x / 17) - 1.5 * np.sin(x / 9 + 1)
    lines = np.exp(3 * (np.cos(wave * (2 * np.pi / 9.5)) - 1))
    forehead = np.exp(-((x / 36) ** 2) - ((y - 47) / 13) ** 2) * (z > 40)
    fan = np.exp(4 * (np.cos((y - 2) / np.maximum(np.abs(x) - 38, 4) * 14) - 1))
    temple = np.exp(-(((np.abs(x) - 53) / 6) ** 2) - (y / 9) ** 2) * (z > 30)
    return 0.5 * lines * forehead + 0.5 * fan * temple
