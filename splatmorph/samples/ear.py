"""An ear: a shell with its rim, inner ridge, hollow and lobe."""

from __future__ import annotations

import numpy as np

from splatmorph.samples.implicit import Array, capsule, column, ellipsoid, join, length, tube
from splatmorph.samples.people import Person

FAR = 30.0


def ear_frame(person: Person) -> tuple[Array, Array]:
    """Center (3, 1) and rotation (3, 3), rows the outward, up and back axes of the left ear."""
    flare, lean = np.radians(person.ear_flare), np.radians(12.0)
    back = np.array([np.sin(flare), 0, -np.cos(flare)])
    up = np.array([0, 1.0, 0])
    out = np.cross(up, back)
    if out[0] < 0:
        out = -out
    up, back = np.cos(lean) * up + np.sin(lean) * back, np.cos(lean) * back - np.sin(lean) * up
    center = column((person.ear_x, -14, -12))
    return center, np.stack([out, up, back]).astype(np.float32)


def outline(angle: float) -> tuple[float, float]:
    """(up, back) of the rim at an angle from the front root over the top, for a height of 2."""
    up = np.sin(angle)
    back = -np.cos(angle) * (0.62 if np.cos(angle) > 0 else 0.60)
    if up < 0:
        back *= 1 - 0.45 * up * up
    return float(up), float(back)


def ear(person: Person, m: Array) -> tuple[Array, Array]:
    """Signed distances of the ear and of the hollow to be cut from it."""
    center, axes = ear_frame(person)
    half = person.ear_height / 2
    body = np.full(m.shape[1], FAR, np.float32)
    hollow = body.copy()
    away = length(m - center)
    body = away - half * 1.2
    hollow = body.copy()
    inside = np.flatnonzero(away < half * 1.9)
    q = axes @ (m[:, inside] - center) / half
    body[inside] = half * shell(q)
    hollow[inside] = half * bowl(q)
    return body, hollow


def shell(q: Array) -> Array:
    """The ear of half-height 1: axes outward, up and back."""
    plate = ellipsoid(q, (-0.02, 0.05, 0.02), (0.10, 0.90, 0.54))
    angles = np.radians(np.linspace(-25, 245, 14))
    rim = [(0.10 - 0.10 * (i == 0), *outline(a)) for i, a in enumerate(angles)]
    rim = [(x, 0.94 * u, 0.94 * b) for x, u, b in rim]
    radii = np.linspace(0.10, 0.085, len(rim)).tolist()
    d = join(plate, tube(q, rim, radii), 0.08)
    ridge = [(0.09, 0.55, 0.12), (0.12, 0.25, 0.27), (0.13, -0.15, 0.27), (0.10, -0.45, 0.08)]
    d = join(d, tube(q, ridge, (0.05, 0.08, 0.09, 0.07)), 0.10)
    lobe = ellipsoid(q, (0.03, -0.80, -0.02), (0.12, 0.24, 0.25))
    d = join(d, lobe, 0.12)
    tragus = capsule(q, (0.06, -0.12, -0.50), (0.10, -0.28, -0.40), 0.09, 0.09)
    d = join(d, tragus, 0.10)
    root = ellipsoid(q, (-0.28, -0.02, -0.08), (0.28, 0.55, 0.30))
    return join(d, root, 0.10)


def bowl(q: Array) -> Array:
    """What is scooped out: the concha and the groove inside the rim."""
    concha = ellipsoid(q, (0.14, -0.14, -0.08), (0.22, 0.30, 0.24))
    groove = ellipsoid(q, (0.16, 0.58, 0.20), (0.10, 0.20, 0.16))
    return np.minimum(concha, groove)
