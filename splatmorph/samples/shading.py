"""Light baked into the strokes: ambient occlusion, a soft key light, a rim, and a sheen."""

from __future__ import annotations

import numpy as np

from splatmorph.samples.implicit import Array, Field, column, smoothstep
from splatmorph.samples.splats import Strokes
from splatmorph.samples.surface import Grid


def unit(x: float, y: float, z: float) -> Array:
    v = column((x, y, z))
    return v / np.linalg.norm(v)


KEY = unit(-0.55, 0.62, 0.75)
RIM = unit(0.85, 0.35, -0.55)
KEY_COLOR = column((1.90, 1.78, 1.62))
RIM_COLOR = column((0.55, 0.62, 0.75))
SKY = column((0.58, 0.59, 0.63))
GROUND = column((0.46, 0.35, 0.29))
WRAP = column((0.42, 0.24, 0.18))
"""How far the key light creeps round the terminator: red light travels furthest in skin."""


def linear(srgb: Array) -> Array:
    return np.power(np.clip(srgb, 0, 1), 2.2, dtype=np.float32)


def display(light: Array) -> Array:
    """Radiance to sRGB through a soft shoulder."""
    mapped = light * (1 + light / 6.0) / (1 + 0.62 * light)
    return np.power(np.clip(mapped, 0, 1), 1 / 2.2, dtype=np.float32)


def fibonacci(count: int) -> Array:
    """(3, count) directions spread evenly over the sphere."""
    k = np.arange(count) + 0.5
    y, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - y * y)
    return np.stack([r * np.cos(turn), y, r * np.sin(turn)]).astype(np.float32)


def sky_share(grid: Grid, p: Array, n: Array, directions: int = 20) -> Array:
    """(n,) cosine-weighted share of the surroundings that is not hidden by the solid."""
    total = np.zeros(p.shape[1], np.float32)
    weight = total.copy()
    start = p + 2.5 * n
    for direction in fibonacci(directions).T[:, :, None]:
        cosine = np.maximum((n * direction).sum(0) + 0.15, 0)
        seen = np.flatnonzero(cosine)
        clear = np.ones(seen.size, np.float32)
        for distance in (5.0, 12.0, 26.0, 52.0):
            gap = grid(start[:, seen] + direction * distance)
            clear = np.minimum(clear, smoothstep(-0.25, 0.35, gap / distance))
        total[seen] += cosine[seen] * clear
        weight += cosine
    return total / np.maximum(weight, 1e-3)


def creases(field: Field, p: Array, n: Array) -> Array:
    """(n,) fine occlusion in folds, from a few distances above the surface."""
    shade = np.ones(p.shape[1], np.float32)
    for height, strength in ((0.8, 0.30), (1.8, 0.30), (4.0, 0.30)):
        shade -= strength * np.clip((height - field(p + height * n)) / height, 0, 1)
    return np.clip(shade, 0.12, 1)


def key_share(grid: Grid, p: Array, n: Array) -> Array:
    """(n,) soft shadow of the key light, 1 in full light."""
    clear = np.ones(p.shape[1], np.float32)
    start = p + 2.5 * n
    for distance in np.geomspace(4, 130, 14).astype(np.float32):
        gap = grid(start + KEY * distance)
        clear = np.minimum(clear, smoothstep(-0.07, 0.16, gap / distance))
    return clear


def strand_highlight(strokes: Strokes) -> Array:
    """The band of light across combed hair, seen from the front (Kajiya and Kay, 1989)."""
    half = KEY + unit(0, 0, 1)
    half /= np.linalg.norm(half)
    band = (1 - (strokes.along * half).sum(0) ** 2) ** 18
    strand = smoothstep(2.0, 3.5, strokes.sizes[0] / strokes.sizes[1])
    facing = np.clip((strokes.normals * half).sum(0), 0, 1)
    return 0.9 * strand * strokes.gloss * band * facing


def shade(strokes: Strokes, grid: Grid, folds: Array) -> tuple[Array, Array]:
    """Base colour (3, n) and its slope with the view direction (3, 3, n), both sRGB.

    ``folds`` is the fine occlusion of each stroke, from ``creases``.
    """
    p, n = strokes.points, strokes.normals
    open_sky = sky_share(grid, p, n) * folds * strokes.light
    lit = key_share(grid, p, n) * np.sqrt(folds) * strokes.light
    toward_key = (n * KEY).sum(0)
    key = np.clip((toward_key + WRAP) / (1 + WRAP), 0, 1) ** 1.3
    up = 0.5 + 0.5 * n[1]
    ambient = GROUND + (SKY - GROUND) * up
    rim = np.clip((n * RIM).sum(0), 0, 1) ** 1.5
    light = ambient * open_sky + KEY_COLOR * key * (0.14 + 0.86 * lit)
    light = light + RIM_COLOR * rim * open_sky
    light = light + KEY_COLOR * strand_highlight(strokes) * lit
    # Light that bounces between the walls of a fold takes the fold's colour.
    albedo = linear(strokes.colors)
    bounce = albedo ** (0.35 * (1 - folds))
    base = display(albedo * light * bounce)

    mirror = 2 * toward_key * n - KEY
    facing = np.clip(toward_key * 1.5 + 0.2, 0, 1) * lit * strokes.gloss
    sheen = mirror * facing * 0.30 - n * (0.10 * strokes.gloss * open_sky)
    slope = KEY_COLOR[:, None] / KEY_COLOR.max() * sheen[None]
    resting = (slope * n).sum(1)
    return base - 0.85 * resting, slope
