"""Hair: strands of long thin splats that follow a combed direction over the skull."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from splatmorph.samples.head import Head
from splatmorph.samples.implicit import (
    Array,
    Field,
    column,
    ellipsoid,
    gradient,
    join,
    length,
    mirrored,
    normals,
    project,
    smoothstep,
)
from splatmorph.samples.skin import beard, hairline, in_ear, mix, noise
from splatmorph.samples.splats import Strokes, tangential

Direction = Callable[[Array, Array], Array]

BUN_CENTER = (0.0, 112.0, -58.0)
BUN_RADII = (31.0, 27.0, 29.0)
BUN_AXIS = column((0.0, 0.80, -0.60))


def scalp(head: Head) -> Field:
    """The skull and neck that hair lies on: no ears, nose or mouth."""

    def field(p: Array) -> Array:
        m = mirrored(p)
        return join(head.with_sockets(m, head.skull(m)), head.neck(m), 14)

    return field


def volume(head: Head, share: float = 0.5) -> Field:
    """Signed distance to the mass of the hair up to a share of its height."""
    skin, swept = scalp(head), head.person.bun
    tall = swept_height if swept else cropped_height

    def field(p: Array) -> Array:
        d = skin(p) - share * tall(head, p)
        return np.minimum(d, bun(p)) if swept else d

    return field


def swept_height(head: Head, p: Array) -> Array:
    """Height of hair combed to the bun over the scalp, mm."""
    return 6.0 * smoothstep(-2, 30, hairline(head, p))


def cropped_height(head: Head, p: Array) -> Array:
    """Height of short hair, longest on top."""
    above = hairline(head, p)
    full = smoothstep(0, 28, above) * smoothstep(-60, 40, p[1])
    return smoothstep(-2, 4, above) * (2.0 + 5.0 * full)


def bun(p: Array) -> Array:
    return ellipsoid(p, BUN_CENTER, BUN_RADII)


def strands(
    field: Field,
    roots: Array,
    direction: Direction,
    level: Callable[[Array, float], Array],
    steps: int,
    reach: Array | float,
) -> tuple[Array, Array, Array]:
    """Strands grown from ``roots``: midpoints, unit directions and lengths of their pieces.

    ``direction`` is what a comb would do at (p, n); ``level(p, s)`` is the height above the
    field's surface that a strand has there at the fraction s of its length.
    """
    points = [project(field, roots, steps=2, level=level(roots, 0.0))]
    for step in range(steps):
        p = points[-1]
        n = normals(field, p)
        ahead = p + tangential(direction(p, n), n) * reach
        points.append(project(field, ahead, steps=1, level=level(ahead, (step + 1) / steps)))
    start, end = np.concatenate(points[:-1], 1), np.concatenate(points[1:], 1)
    piece = end - start
    size = np.maximum(length(piece), 1e-3)
    return (start + end) / 2, piece / size, size


def paint(
    field: Field,
    pieces: tuple[Array, Array, Array],
    width: Array | float,
    colors: Array,
    light: Array,
    gloss: float,
) -> Strokes:
    points, along, size = pieces
    count = points.shape[1]
    n = gradient(field, points, 1.5)
    n = tangential(n, along)
    wide = np.broadcast_to(np.asarray(width, np.float32), (count,))
    sizes = np.stack([0.42 * size, wide, 0.35 * wide]).astype(np.float32)
    shine = np.full(count, gloss, np.float32)
    return Strokes(
        points.astype(np.float32),
        n.astype(np.float32),
        along.astype(np.float32),
        sizes,
        np.clip(colors, 0, 1).astype(np.float32),
        shine,
        light.astype(np.float32),
    )


def drawn_back(head: Head, skin: Array, rng: np.random.Generator) -> Strokes:
    """Long hair combed to the bun."""
    a = head.person
    field = scalp(head)
    target = column(BUN_CENTER)
    inside = (hairline(head, skin) > 1.5) & (in_ear(head, skin) < 0.3) & (bun(skin) > -3)
    roots = rng.choice(skin[:, inside], 1500, axis=1)
    roots += rng.normal(0, 1.5, roots.shape).astype(np.float32)
    depth = rng.random(roots.shape[1], np.float32)

    def groove(p: Array) -> Array:
        # A coordinate that a strand keeps on its way to the bun: its angle round the bun's axis.
        q = p - target
        side = q[0]
        front = q[1] * 0.6 + q[2] * 0.8
        angle = np.arctan2(side, front)
        return np.sin(angle * 34 + 2 * np.sin(angle * 9)) * 0.6 + np.sin(angle * 71 + 1) * 0.4

    def level(p: Array, s: float) -> Array:
        return 0.6 + swept_height(head, p) * (0.25 + 0.75 * depth + 0.16 * groove(p))

    def comb(p: Array, n: Array) -> Array:
        return target - p

    steps, reach = 4, 9.0
    pieces = strands(field, roots, comb, level, steps, reach)
    points = pieces[0]
    depths = np.tile(depth, steps)
    keep = (bun(points) > -4) & (hairline(head, points) > -1)
    mark = groove(points)
    tone = 0.35 + 0.40 * depths + 0.22 * mark + 0.10 * rng.normal(size=points.shape[1])
    colors = mix(column(a.hair), a.hair_tip, np.clip(tone, 0, 1))
    light = 0.45 + 0.45 * depths + 0.14 * mark
    grown = smoothstep(-2, 12, hairline(head, points))
    width = (1.05 + 0.5 * rng.uniform(size=points.shape[1])) * (0.4 + 0.6 * grown)
    return paint(field, pieces, width, colors, light, 1.1).select(keep)


def wound(head: Head, rng: np.random.Generator) -> Strokes:
    """The bun: strands that wind round its axis and over its top."""
    a = head.person
    roots: Array = rng.normal(size=(3, 420)).astype(np.float32)
    roots = roots / length(roots) * column(BUN_RADII) + column(BUN_CENTER)
    depth = rng.random(roots.shape[1], np.float32)

    def twist(p: Array) -> Array:
        q = (p - column(BUN_CENTER)) / column(BUN_RADII)
        height = (q * BUN_AXIS).sum(0)
        angle = np.arctan2(q[0], q[1] * 0.6 + q[2] * 0.8)
        return np.sin(2 * angle - 5.5 * height)

    def level(p: Array, s: float) -> Array:
        return -3.0 + 3.0 * depth + 2.6 * twist(p)

    def comb(p: Array, n: Array) -> Array:
        return np.cross(np.broadcast_to(BUN_AXIS, p.shape), n, axis=0) + 0.36 * BUN_AXIS

    steps = 5
    pieces = strands(bun, roots, comb, level, steps, 6.0)
    points = pieces[0]
    keep = scalp(head)(points) > 1
    depths, mark = np.tile(depth, steps), twist(points)
    tone = 0.30 + 0.40 * depths + 0.30 * mark + 0.10 * rng.normal(size=points.shape[1])
    colors = mix(column(a.hair), a.hair_tip, np.clip(tone, 0, 1))
    light = 0.50 + 0.40 * depths + 0.28 * mark
    return paint(bun, pieces, 1.3, colors, light, 1.1).select(keep)


def cropped(head: Head, skin: Array, rng: np.random.Generator) -> Strokes:
    """Short hair brushed back on top and down at the sides."""
    a = head.person
    field = scalp(head)
    above = hairline(head, skin)
    inside = (above > rng.uniform(-1, 9, above.size)) & (in_ear(head, skin) < 0.3)
    roots = rng.choice(skin[:, inside], 2250, axis=1)
    roots += rng.normal(0, 1.5, roots.shape).astype(np.float32)
    lock = noise(roots, 16, a.seed + 9)
    depth = np.clip(rng.uniform(0, 1, roots.shape[1]) + 0.25 * lock, 0, 1).astype(np.float32)
    tall = cropped_height(head, roots)

    def level(p: Array, s: float) -> Array:
        return 0.5 + 1.1 * tall * (0.3 + 0.7 * depth) * (0.35 + 0.65 * s)

    sway = 0.5 * noise(roots, 22, a.seed + 10)

    def comb(p: Array, n: Array) -> Array:
        top = smoothstep(30, 85, p[1])
        side = np.sign(p[0]) * smoothstep(0, 20, np.abs(p[0]))
        back = np.stack([0.35 * side + sway, 0.1 - 1.1 * (1 - top), -0.9 * top - 0.55 * (1 - top)])
        return back.astype(np.float32)

    steps = 3
    reach = (2.0 + 0.65 * tall) * (0.8 + 0.4 * rng.random(roots.shape[1], np.float32))
    pieces = strands(field, roots, comb, level, steps, reach)
    points = pieces[0]
    depths = np.tile(depth, steps)
    tip = np.repeat(np.linspace(0, 1, steps), roots.shape[1])
    temples = smoothstep(40, -10, points[1])
    tone = 0.25 + 0.35 * depths + 0.15 * tip + 0.15 * temples + 0.13 * rng.normal(size=tip.size)
    colors = mix(column(a.hair), a.hair_tip, np.clip(tone, 0, 1))
    light = 0.50 + 0.40 * depths + 0.15 * tip
    width = 0.75 + 0.25 * rng.uniform(size=tip.size)
    return paint(field, pieces, width, colors, light, 0.7)


def bearded(head: Head, skin: Array, rng: np.random.Generator) -> Strokes:
    """A short full beard."""
    a = head.person
    density = beard(head, skin)
    inside = density > rng.uniform(0.1, 1.0, density.size)
    roots = rng.choice(skin[:, inside], 1950, axis=1)
    roots += rng.normal(0, 0.5, roots.shape).astype(np.float32)
    depth = rng.random(roots.shape[1], np.float32)
    q = head.mouth_frame(mirrored(roots))
    moustache = smoothstep(-2, 2, q[1]) * smoothstep(
        a.mouth_half_width + 12, a.mouth_half_width, mirrored(roots)[0]
    )
    thick = smoothstep(0.2, 1.0, beard(head, roots)) * (1 - 0.5 * moustache)
    long = smoothstep(-70, -115, roots[1]) * smoothstep(10, 60, roots[2])

    def level(p: Array, s: float) -> Array:
        return 0.3 + (2.0 + 5.0 * long) * thick * (0.35 + 0.65 * depth) * (0.3 + 0.7 * s)

    sway = 0.35 * noise(roots, 15, a.seed + 12)

    def comb(p: Array, n: Array) -> Array:
        out = np.sign(p[0]) * (0.15 + 0.75 * moustache) * smoothstep(0, 6, np.abs(p[0]))
        down = -1.0 + 0.25 * moustache
        return np.stack([out + sway, down, 0.25 - 0.5 * (p[1] < -105)]).astype(np.float32)

    steps = 2
    reach = (2.8 + 2.6 * long) * (0.8 + 0.4 * rng.random(roots.shape[1], np.float32))
    pieces = strands(head, roots, comb, level, steps, reach)
    points = pieces[0]
    tip = np.repeat(np.linspace(0, 1, steps), roots.shape[1])
    pepper = rng.normal(size=roots.shape[1])
    tone = 0.35 + 0.30 * np.tile(depth, steps) + 0.15 * tip + 0.22 * np.tile(pepper, steps)
    chin = smoothstep(30, 8, np.abs(points[0])) * smoothstep(-85, -100, points[1])
    colors = mix(column(a.hair) * 0.85, a.hair_tip, np.clip(tone + 0.2 * chin, 0, 1))
    light = 0.62 + 0.30 * np.tile(depth, steps) + 0.12 * tip
    clear = np.minimum(*head.lips(mirrored(points))) > 0.3
    return paint(head, pieces, 0.72, colors, light, 0.4).select(clear)
