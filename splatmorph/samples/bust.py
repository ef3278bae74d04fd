"""One person's splat, put together."""

from __future__ import annotations

import numpy as np

from splatmorph.gaussians import Gaussians
from splatmorph.samples import eyes, hair
from splatmorph.samples.clothes import Garment, studs
from splatmorph.samples.head import Head
from splatmorph.samples.implicit import Array, Field, column, length, mirrored, normals, smoothstep
from splatmorph.samples.people import Person
from splatmorph.samples.shading import creases, shade
from splatmorph.samples.skin import beard, hairline, skin_colors
from splatmorph.samples.splats import Strokes, flat, to_gaussians
from splatmorph.samples.surface import Grid, local_spacing, scatter

LOW, HIGH = (-150.0, -222.0, -132.0), (150.0, 150.0, 140.0)
CELL = 6.0
OVERLAP = 0.56
"""A flake's standard deviation over its ring's distance: no gaps, little blur."""


def skin_spacing(head: Head) -> Field:
    """Distance between neighbouring skin splats: fine where the face is finely shaped."""
    a = head.person

    def spacing(p: Array) -> Array:
        m = mirrored(p)
        eye = length((m - column((a.eye_x, 1, a.eye_z + 8))) / column((1.25, 1, 1)))
        mouth = length((m - column((0, a.mouth_y, a.mouth_z - 2))) / column((1.5, 0.8, 1)))
        nose = length(m - column((0, a.nose_tip[1] - 2, a.nose_tip[2] - 10)))
        ear = length(m - column((a.ear_x, -14, -12))) - 6
        fine = np.minimum(np.minimum(eye, mouth), np.minimum(nose, ear + 4))
        out = 1.40 + 1.80 * smoothstep(10, 48, fine)
        out = out + 2.4 * smoothstep(-2, 14, hairline(head, p)) * smoothstep(6, 22, ear)
        if a.beard:
            out = out + 1.2 * beard(head, p)
        return out + 1.2 * smoothstep(-100, -135, p[1])

    return spacing


def strokes(person: Person) -> tuple[Strokes, Array, Grid]:
    """All marks of the bust, their fine occlusion, and the grid that shades them."""
    rng = np.random.default_rng(person.seed)
    head = Head(person)
    garment = Garment(head)
    locks = hair.volume(head)

    def solid(p: Array) -> Array:
        return np.minimum(np.minimum(head(p), garment(p)), locks(p))

    grid = Grid.of(head, LOW, HIGH, CELL)
    skin = scatter(head, grid, skin_spacing(head), rng)
    skin = skin[:, garment(skin) > -0.8]
    colors, gloss = skin_colors(head, skin)
    n = normals(head, skin)
    parts = [flat(skin, n, OVERLAP * local_spacing(skin), colors, gloss)]
    folds = [creases(head, skin, n)]

    cloth_grid = Grid.of(garment, LOW, (150.0, -110.0, 140.0), CELL)
    cloth = scatter(garment, cloth_grid, garment.spacing, rng)
    cloth = cloth[:, head(cloth) > 0.5]
    n = normals(garment, cloth)
    parts.append(flat(cloth, n, OVERLAP * local_spacing(cloth), garment.colors(cloth), 0.15))
    folds.append(creases(garment, cloth, n))

    loose = [eyes.eyeballs(head), eyes.lashes(head, rng), eyes.brows(head, rng)]
    if person.studs:
        loose.append(studs(head))
    if person.bun:
        loose += [hair.drawn_back(head, skin, rng), hair.wound(head, rng)]
    else:
        loose.append(hair.cropped(head, skin, rng))
    if person.beard:
        loose.append(hair.bearded(head, skin, rng))
    folds += [np.ones(len(part), np.float32) for part in loose]
    parts += loose
    return Strokes.concatenate(parts), np.concatenate(folds), Grid.of(solid, LOW, HIGH, CELL)


def portray(person: Person) -> Gaussians:
    """The person's splat in metres, spherical harmonics of degree 1."""
    marks, folds, grid = strokes(person)
    base, slope = shade(marks, grid, folds)
    return to_gaussians(marks, base, slope)
