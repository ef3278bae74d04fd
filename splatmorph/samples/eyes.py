"""Eyeballs as painted spheres, with lashes and brows of hair."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatmorph.samples.head import EYEBALL, LID, Head
from splatmorph.samples.implicit import Array, column, length, normals, project, smoothstep
from splatmorph.samples.skin import mix
from splatmorph.samples.splats import Strokes, flat, tangential

IRIS = 6.5
PUPIL = 2.4
SPACING = 0.75


def eyeballs(head: Head) -> Strokes:
    """Both visible fronts: sclera, iris, pupil and the light's reflection."""
    return Strokes.concatenate([eyeball(head, side) for side in (1, -1)])


def eyeball(head: Head, side: int) -> Strokes:
    a = head.person
    count = int(4 * np.pi * EYEBALL**2 / SPACING**2)
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    n = np.stack([r * np.cos(turn), r * np.sin(turn), z]).astype(np.float32)
    q = n * EYEBALL
    folded = np.stack([side * q[0], q[1], q[2]])
    keep = (head.lid_gap(folded) < 2.2) & (q[2] > 1)
    n, q, folded = n[:, keep], q[:, keep], folded[:, keep]
    center = column((side * a.eye_x, 0, a.eye_z))

    # The gaze is straight ahead, a little inward.
    u, v = q[0] + side * 0.25, q[1] - 0.2
    radius, angle = np.hypot(u, v), np.arctan2(v, u)
    color = column((0.93, 0.90, 0.88)) * np.ones_like(q)
    pink = smoothstep(6, a.eye_half_width, np.abs(q[0]))
    color = mix(color, (0.86, 0.62, 0.58), 0.45 * pink)
    rays = np.sin(angle * 23 + 3 * np.sin(angle * 5)) * 0.5 + np.sin(angle * 41 + 1) * 0.3
    inner = smoothstep(IRIS, PUPIL, radius)
    iris = column(a.iris) * (0.80 + 0.75 * smoothstep(0.3, -0.9, v / IRIS) + 0.22 * rays)
    iris = mix(
        iris, tuple(min(1.0, 1.5 * c + 0.10) for c in (a.iris[0] + 0.08, *a.iris[1:])), 0.30 * inner
    )
    iris = mix(iris, tuple(0.22 * c for c in a.iris), smoothstep(IRIS - 1.5, IRIS - 0.2, radius))
    color = mix(color, iris, smoothstep(IRIS + 0.35, IRIS - 0.35, radius))
    color = mix(color, (0.012, 0.012, 0.015), smoothstep(PUPIL + 0.4, PUPIL - 0.4, radius))
    # The upper lid and its lashes cast a shadow on the ball.
    edge = -head.lid_gap(folded) * 1.2
    lid_shadow = 0.45 + 0.55 * smoothstep(-0.5, 4.0, edge + 1.5 * smoothstep(2, -2, q[1]))
    size = np.full(q.shape[1], 0.72 * SPACING, np.float32)
    ball = flat(q + center, n, size, np.clip(color, 0, 1), 0.35)
    ball = replace(ball, light=lid_shadow.astype(np.float32))

    glint_at = [(-2.3, 2.6, 0.85), (-1.5, 2.5, 0.75), (-2.0, 1.9, 0.75), (2.4, -2.2, 0.42)]
    spot = np.array([[x, y, np.sqrt((EYEBALL + 0.5) ** 2 - x * x - y * y)] for x, y, _ in glint_at])
    spot = spot.T.astype(np.float32)
    size = np.array([s for _, _, s in glint_at], np.float32)
    glint = flat(spot + center, spot / length(spot), size, np.full_like(spot, 1.0), 0.9)
    glint = replace(glint, light=np.array([3, 3, 3, 0.9], np.float32))
    return Strokes.concatenate([ball, glint])


def lashes(head: Head, rng: np.random.Generator) -> Strokes:
    """Upper lashes: short dark strands that sweep up and outward from the lid's edge."""
    a = head.person
    count = 44
    u = rng.uniform(-0.75, 0.94, 2 * count).astype(np.float32)
    side = np.repeat([1.0, -1.0], count).astype(np.float32)
    x = u * a.eye_half_width
    y = a.lid_upper * (1 - u * u) * (1 - 0.14 * u) + a.eye_tilt * x + 0.2
    z = np.sqrt(np.maximum((EYEBALL + LID) ** 2 - x * x - y * y, 4))
    reach = (3.4 + 3.4 * smoothstep(-0.6, 1, u)) * (1 - 0.5 * a.age) * rng.uniform(0.6, 1.2, x.size)
    fan = 0.75 * u + 0.22 * rng.normal(size=x.size)
    strands = [
        np.stack([x + reach * s * fan, y + reach * s * (0.1 + 0.6 * s), z + reach * s * 0.7])
        for s in (0.2, 0.62)
    ]
    a_, b_ = (np.stack([side * s[0], s[1], s[2]]) for s in strands)
    along = (b_ - a_) / length(b_ - a_)
    center = np.stack([side * a.eye_x, 0 * x, 0 * x + a.eye_z])
    points = (np.concatenate([a_, b_], 1) + np.tile(center, 2)).astype(np.float32)
    along = np.tile(along, 2).astype(np.float32)
    normal = tangential(np.tile(column((0, 0.3, 1)), (1, points.shape[1])), along)
    n = points.shape[1]
    sizes = np.stack([np.tile(reach * 0.17, 2), np.full(n, 0.17), np.full(n, 0.12)])
    color = column(a.brow) * 0.5 * np.ones((3, n), np.float32)
    ones = np.ones(n, np.float32)
    return Strokes(points, normal, along, sizes.astype(np.float32), color, 0.1 * ones, ones)


def brow_curve(head: Head, t: Array) -> tuple[Array, Array]:
    """(x, y) along the left brow's middle line, t from 0 at the nose to 1 at the temple."""
    a = head.person
    x = 11 + (a.eye_x * 1.62 - 11) * t
    rise = a.brow_arch
    y = 16.0 - a.brow_drop + rise * np.sin(np.pi * (0.12 + 0.6 * t)) - 2.5 * t * t
    return x, y


def brows(head: Head, rng: np.random.Generator) -> Strokes:
    """Brows of short strands, upright near the nose and lying outward at the tail."""
    a = head.person
    count = a.brow_hairs
    t = rng.uniform(0, 1, count).astype(np.float32) ** 0.75
    side = rng.choice(np.array([-1.0, 1.0], np.float32), count)
    across = rng.uniform(-1, 1, count).astype(np.float32)
    x, y = brow_curve(head, t)
    width = a.brow_width * (0.4 + 0.6 * smoothstep(0, 0.3, t)) * smoothstep(1.12, 0.5, t)
    y = y + across * width * 0.5
    p = np.stack([side * x, y, np.full(count, 110, np.float32)])
    p[2] = a.eye_z + 22 - 0.006 * x * x
    p = project(head, p, steps=5)
    n = normals(head, p)
    lean = 1.15 - 0.95 * t - 0.5 * across * smoothstep(0.1, 0.5, t)
    along = tangential(np.stack([side * np.cos(lean), np.sin(lean), 0.1 * t]), n)
    along = tangential(along + 0.18 * rng.normal(size=p.shape), n).astype(np.float32)
    n = (n - 0.2 * along).astype(np.float32)
    n /= length(n)
    along = tangential(along, n)
    size = rng.uniform(0.8, 1.2, count)
    long, thin = 1.5 + 0.6 * a.age, 0.36
    sizes = np.stack([long * size, thin * size, np.full(count, 0.14)]).astype(np.float32)
    tone = column(a.brow) * rng.uniform(0.7, 1.35, count).astype(np.float32)
    lift = rng.uniform(0.5, 1.2 + 1.2 * a.age, count).astype(np.float32)
    ones = np.ones(count, np.float32)
    return Strokes(p + n * lift, n, along, sizes, np.clip(tone, 0, 1), 0.2 * ones, ones)
