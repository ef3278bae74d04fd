"""Pictures about a morph: the contact sheet and the warped grid."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from PIL import Image, ImageDraw
from torch import Tensor

from splatmorph.images.canvas import Canvas
from splatmorph.images.morph import ImageMorph
from splatmorph.images.picture import Pixels
from splatmorph.images.warp import Warp

SHEET_WIDTH = 1920
PANEL = 900
GAP = 8
CELLS = 32
SMOOTH = 2
"""Lines are drawn this much larger, then reduced: Pillow does not smooth them itself."""

GRID, SEEN, GIVEN = (255, 196, 0), (230, 30, 60), (0, 170, 255)
"""Colours of the grid, of where landmarks are, of where they were to be."""


def contact_sheet(frames: Sequence[Pixels], columns: int | None = None) -> Pixels:
    """All frames (h, w, 3) uint8 in rows, from left to right, ``SHEET_WIDTH`` pixels wide."""
    columns = columns or math.ceil(math.sqrt(len(frames)))
    height, width = frames[0].shape[:2]
    across = min(width, (SHEET_WIDTH - GAP * (columns + 1)) // columns)
    down = max(1, round(height * across / width))
    rows = math.ceil(len(frames) / columns)
    sheet = Image.new(
        "RGB", (GAP + columns * (across + GAP), GAP + rows * (down + GAP)), (255, 255, 255)
    )
    for i, frame in enumerate(frames):
        row, column = divmod(i, columns)
        small = Image.fromarray(frame).resize((across, down), Image.Resampling.LANCZOS)
        sheet.paste(small, (GAP + column * (across + GAP), GAP + row * (down + GAP)))
    return np.array(sheet)


def warped_grid(morph: ImageMorph, source: Tensor, target: Tensor) -> Pixels:
    """Source, middle and target, each under the source's grid carried there by the warp.

    ``source`` and ``target`` are the matched landmarks (k, 2), world. Yellow: the grid; red:
    where the source's landmarks are carried; blue rings: where the target's are, on the target.
    """
    panels = []
    for t in (0.0, 0.5, 1.0):
        picture = Image.fromarray(morph.at(t).rgb()).convert("RGB")
        factor = min(1.0, PANEL / max(picture.size))
        size = [max(1, round(side * factor)) for side in picture.size]
        image = picture.resize([SMOOTH * side for side in size], Image.Resampling.LANCZOS)
        _draw(image, morph.output, morph.warp, t, source, target if t == 1 else None)
        panels.append(np.array(image.resize(size, Image.Resampling.LANCZOS)))
    return contact_sheet(panels, columns=3)


def _draw(
    image: Image.Image,
    canvas: Canvas,
    warp: Warp,
    t: float,
    source: Tensor,
    target: Tensor | None,
) -> None:
    draw = ImageDraw.Draw(image)
    scale = image.width / canvas.width

    def place(points: Tensor) -> list[tuple[float, float]]:
        return [(x * scale, y * scale) for x, y in canvas.to_pixels(points).tolist()]

    lines = _grid_lines(canvas)
    moved = warp.carry(lines.flatten(0, 1), t).view(lines.shape)
    for line in moved:
        draw.line(place(line), fill=GRID, width=SMOOTH)
    radius = 2 * SMOOTH
    for x, y in place(warp.carry(source, t)):
        draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill=SEEN)
    for x, y in place(target) if target is not None else []:
        ring = 2 * radius
        draw.ellipse([x - ring, y - ring, x + ring, y + ring], outline=GIVEN, width=SMOOTH)


def _grid_lines(canvas: Canvas) -> Tensor:
    """(lines, points, 2) world: the lines of a square grid over the canvas."""
    half = torch.tensor(canvas.half, dtype=torch.float64)
    along = torch.linspace(-1, 1, 8 * CELLS + 1, dtype=torch.float64)
    lines = []
    for axis in (0, 1):
        count = max(2, round(CELLS * float(half[axis])))
        for place in torch.linspace(-1, 1, count + 1, dtype=torch.float64):
            unit = torch.stack([torch.full_like(along, float(place)), along], dim=1)
            lines.append((unit if axis == 0 else unit.flip(1)) * half)
    return torch.stack(lines)
