"""The colour of skin: base tone, blush, lips, shadows of stubble, mottling."""

from __future__ import annotations

import numpy as np

from splatmorph.samples.ear import ear
from splatmorph.samples.head import EYEBALL, Head
from splatmorph.samples.implicit import Array, column, length, mirrored, smoothstep


def noise(p: Array, wavelength: float, seed: int, waves: int = 14) -> Array:
    """(n,) smooth noise of about unit variance: a sum of plane waves."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(waves, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    k = (2 * np.pi / wavelength * rng.uniform(0.7, 1.4, (waves, 1)) * direction).astype(np.float32)
    phase = rng.uniform(0, 2 * np.pi, (waves, 1)).astype(np.float32)
    return np.sin(k[:, :1] * p[0] + k[:, 1:2] * p[1] + k[:, 2:] * p[2] + phase).sum(0) * np.sqrt(
        2 / waves
    )


def mix(a: Array, b: tuple[float, ...] | Array, weight: Array) -> Array:
    b = column(b) if isinstance(b, tuple) else b
    return a + (b - a) * weight


def spot(p: Array, center: tuple[float, ...], radii: tuple[float, ...]) -> Array:
    """1 at ``center``, falling smoothly to nothing."""
    q = (p - column(center)) / column(radii)
    return np.exp(-(q * q).sum(0))


def hairline(head: Head, p: Array) -> Array:
    """(n,) height above the hairline in mm: hair grows where it is positive."""
    azimuth = np.degrees(np.arctan2(np.abs(p[0]), p[2] + 10))
    angle, height = np.array(head.person.hairline, np.float32).T
    return p[1] - np.interp(azimuth, angle, height).astype(np.float32)


def beard(head: Head, p: Array) -> Array:
    """(n,) density of the beard in [0, 1]: jaw, chin and moustache, never the lips."""
    a = head.person
    m = mirrored(p)
    azimuth = np.degrees(np.arctan2(m[0], p[2] + 10))
    top = np.interp(azimuth, (0, 24, 40, 62, 78), (a.mouth_y + 4, a.mouth_y + 4, -66, -52, -24))
    under = 2.5 * np.maximum(-108 - p[1], 0)
    low = smoothstep(-136, -126, p[1]) * smoothstep(-2, 8, p[2] - under)
    jaw = smoothstep(6, -4, p[1] - top.astype(np.float32)) * low * smoothstep(84, 76, azimuth)
    q = head.mouth_frame(m)
    moustache = smoothstep(-1, 6, a.mouth_half_width + 9 - m[0] - 0.9 * np.maximum(q[1], 0))
    moustache = (
        moustache * smoothstep(16, 12, q[1]) * smoothstep(-16, -8, q[2]) * smoothstep(-8, 2, q[1])
    )
    lips = np.minimum(*head.lips(m))
    return np.maximum(jaw, moustache) * smoothstep(0.3, 1.5, lips)


def skin_colors(head: Head, p: Array) -> tuple[Array, Array]:
    """Albedo (3, n) sRGB and gloss (n,) of the skin."""
    a = head.person
    m = mirrored(p)
    tone: Array = column(a.skin) * np.ones_like(p)
    y, z = a.nose_tip[1:]
    blush = 0.36 * spot(m, (a.cheekbone[0] - 2, a.cheekbone[1] - 6, 70), (20, 16, 30))
    blush += 0.50 * spot(m, (0, y, z - 4), (15, 11, 16))
    blush += 0.20 * spot(m, a.chin, (16, 12, 20))
    blush += 0.45 * spot(m, (a.ear_x + 3, -14, -8), (12, 40, 26))
    blush += 0.16 * noise(p, 34, a.seed) * (0.4 + 0.6 * smoothstep(20, -20, p[1]))
    tone = mix(tone, a.blush, np.clip(blush * 0.85, 0, 0.7))
    forehead = 0.10 * spot(p, (0, 50, 86), (50, 26, 40))
    tone = mix(tone, (1.0, 0.86, 0.70), forehead)
    q = m - column((a.eye_x, 0, a.eye_z))
    under = spot(q, (2, -11, 9), (13, 5, 12)) * (0.22 + 0.22 * a.age)
    tone = mix(tone, (0.52, 0.34, 0.36), under)
    upper = spot(q, (3, 8, 9), (16, 5, 12)) * 0.32
    tone = mix(tone, (0.50, 0.28, 0.24), upper)
    upper_lip, lower_lip = head.lips(m)
    lips = smoothstep(1.7, 0.1, np.minimum(upper_lip, lower_lip))
    lip_tone = column(a.lips) * (1 + 0.05 * noise(p * column((4, 0.5, 1)), 9, a.seed + 1))
    tone = mix(tone, lip_tone, lips * 0.92)
    gap = head.lid_gap(q)
    ball = length(q) - EYEBALL
    rim = smoothstep(1.6, 0.2, np.abs(gap)) * smoothstep(3.5, 2.0, np.abs(ball)) * (q[2] > 0)
    lash_line = smoothstep(-1, 2, q[1] - a.eye_tilt * q[0])
    edge = rim * smoothstep(-0.95, -0.6, q[0] / a.eye_half_width)
    tone = mix(tone, tuple(0.5 * c for c in a.brow), edge * (0.22 + 0.68 * lash_line))
    nostril = spot(m, (a.nostril_x * 0.55, y - 9, z - 14), (3.2, 3.2, 5))
    tone = mix(tone, (0.22, 0.08, 0.06), 0.8 * nostril)
    caruncle = spot(q, (-a.eye_half_width + 0.5, -0.5, 7), (2.6, 2.2, 5))
    tone = mix(tone, (0.78, 0.42, 0.40), caruncle * (gap < 0.3))
    if a.beard:
        tone = mix(tone, tuple(1.1 * c for c in a.hair), 0.8 * beard(head, p))
    scalp = smoothstep(-4, 9, hairline(head, p) + 1.2 * noise(p, 9, a.seed + 2))
    scalp *= 1 - in_ear(head, p)
    tone = mix(
        tone, tuple((0.62 if a.bun else 1.1) * c for c in a.hair), scalp * (0.95 if a.bun else 0.75)
    )
    tone = tone * (1 + 0.018 * noise(p, 7, a.seed + 3) + 0.012 * noise(p, 3.2, a.seed + 4))
    gloss = 0.40 + 0.25 * spot(m, (0, y + 8, z - 6), (16, 24, 20)) + 0.55 * lips
    gloss += 0.15 * spot(p, (0, 50, 86), (45, 30, 40))
    return np.clip(tone, 0, 1), (gloss * (1 - 0.7 * scalp)).astype(np.float32)


def in_ear(head: Head, p: Array) -> Array:
    """(n,) 1 on the ears."""
    body, _ = ear(head.person, mirrored(p))
    return smoothstep(4, 1, body)
