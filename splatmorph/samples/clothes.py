"""A plain knitted garment with a rolled collar."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatmorph.samples.head import Head
from splatmorph.samples.implicit import Array, join, meet, mirrored, smoothstep
from splatmorph.samples.skin import noise

THICKNESS = 3.5


@dataclass(frozen=True)
class Garment:
    """The solid of the cloth: the body's, swollen by its thickness, below the collar."""

    head: Head

    def __call__(self, p: Array) -> Array:
        m = mirrored(p)
        body = self.head.neck(m)
        above = self.above_collar(p)
        ribs = 0.35 * np.sin(np.arctan2(p[0], p[2] + 20) * 46) * smoothstep(-22, -16, above)
        cloth = meet(body - THICKNESS, above, 3.0) - ribs * smoothstep(6, 0, np.abs(body - THICKNESS))
        roll = np.hypot(np.maximum(np.abs(above + 7) - 5, 0), body - THICKNESS - 0.5) - 3.2
        return join(cloth, roll, 6.0)

    def above_collar(self, p: Array) -> Array:
        """Height above the collar's edge, which lies lower in front."""
        a = self.head.person
        edge = a.collar_y + a.collar_lift * (1 - smoothstep(-60, 40, p[2])) * 2
        return p[1] - edge

    def spacing(self, p: Array) -> Array:
        """Distance between neighbouring splats, finer at the collar."""
        return 3.0 + 2.0 * smoothstep(-18, -30, self.above_collar(p))

    def colors(self, p: Array) -> Array:
        a = self.head.person
        tone = np.array(a.cloth, np.float32)[:, None] * np.ones_like(p)
        knit = 0.05 * noise(p, 6, a.seed + 20) + 0.03 * noise(p, 40, a.seed + 21)
        return np.clip(tone * (1 + knit), 0, 1)
