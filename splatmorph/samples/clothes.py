"""A plain knitted garment with a rolled collar."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatmorph.samples.ear import ear_frame
from splatmorph.samples.head import Head
from splatmorph.samples.implicit import Array, column, join, meet, mirrored, smoothstep
from splatmorph.samples.shading import fibonacci
from splatmorph.samples.skin import noise
from splatmorph.samples.splats import Strokes, flat

THICKNESS = 3.5


@dataclass(frozen=True)
class Garment:
    """The solid of the cloth: the body's, swollen by its thickness, below the collar."""

    head: Head

    def __call__(self, p: Array) -> Array:
        m = mirrored(p)
        body = self.head.neck(m) - THICKNESS
        above = self.above_collar(p)
        cloth = meet(body, above, 3.0)
        roll = np.hypot(np.maximum(np.abs(above + 7) - 5, 0), body - 0.5) - 3.2
        return join(cloth, roll, 6.0)

    def above_collar(self, p: Array) -> Array:
        """Height above the collar's edge, which lies lower in front."""
        a = self.head.person
        edge = a.collar_y + a.collar_lift * (1 - smoothstep(-60, 40, p[2])) * 2
        return p[1] - edge

    def spacing(self, p: Array) -> Array:
        """Distance between neighbouring splats, finer at the collar."""
        return 3.0 + 1.3 * smoothstep(-18, -30, self.above_collar(p))

    def colors(self, p: Array) -> Array:
        a = self.head.person
        tone = np.array(a.cloth, np.float32)[:, None] * np.ones_like(p)
        knit = 0.05 * noise(p, 6, a.seed + 20) + 0.03 * noise(p, 40, a.seed + 21)
        return np.clip(tone * (1 + knit), 0, 1)


def studs(head: Head) -> Strokes:
    """A gold stud on each lobe."""
    center, axes = ear_frame(head.person)
    half = head.person.ear_height / 2
    lobe = center + axes.T @ (column((0.14, -0.84, -0.02)) * half)
    ball = fibonacci(60)
    parts = []
    for side in (1.0, -1.0):
        flip = column((side, 1, 1))
        size = np.full(ball.shape[1], 0.55, np.float32)
        gold = column((0.93, 0.74, 0.36)) * np.ones_like(ball)
        parts.append(flat(lobe * flip + 2.4 * ball, ball, size, gold, 1.5))
    return Strokes.concatenate(parts)
