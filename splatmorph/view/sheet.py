"""The contact sheet: a morph at a glance, t across and views down."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from renderer import Camera
from splatmorph.errors import OptionError
from splatmorph.gaussians import Gaussians
from splatmorph.morph import Morph
from splatmorph.morph.chain import Chain
from splatmorph.rendering import Colour, render

Pixels = NDArray[np.uint8]

PARTS = ("source part", "target part", "union")


def contact_sheet(
    morph: Morph | Chain,
    times: Sequence[float],
    cameras: Sequence[Camera],
    *,
    background: Colour = (1.0, 1.0, 1.0),
    parts: bool = False,
    device: str = "cpu",
) -> Pixels:
    """All of ``times`` from all of ``cameras``, the times written above.

    Arguments:
        times: one a column.
        cameras: one a row; all pictures of one size.
        background: RGB in [0, 1].
        parts: show the fading source G⁰(t) and target G¹(t) above their union, as the paper
            does; three rows a camera.

    Returns the sheet, (height, width, 3) uint8.

    Raises:
        OptionError: no time, no camera, cameras of several sizes, or the parts of a chain.
    """
    halved = morph if parts and isinstance(morph, Morph) else None
    if parts and halved is None:
        raise OptionError("a chain has no two parts to show: choose a run of two splats")
    if not times or not cameras:
        raise OptionError(f"{len(times)} times and {len(cameras)} views, expected some of both")
    sizes = {(camera.width, camera.height) for camera in cameras}
    if len(sizes) > 1:
        raise OptionError(f"pictures of a sheet must have one size, found {sorted(sizes)}")
    columns = []
    for t, whole in zip(times, morph.sequence(times), strict=True):
        shown = [*_halves(halved, t, whole), whole] if halved else [whole]
        columns.append(
            [
                render(splats, camera, background=background, device=device)
                for camera in cameras
                for splats in shown
            ]
        )
    return _laid_out(columns, [f"t = {t:.3g}" for t in times], PARTS if parts else (), background)


def views(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    title: str,
    *,
    background: Colour = (1.0, 1.0, 1.0),
    device: str = "cpu",
) -> Pixels:
    """One splat from all of ``cameras``, which make pictures of one size, below its title.

    Returns the sheet, (height, width, 3) uint8.
    """
    column = [render(gaussians, camera, background=background, device=device) for camera in cameras]
    return _laid_out([column], [title], (), background)


def _halves(morph: Morph, t: float, whole: Gaussians) -> tuple[Gaussians, Gaussians]:
    """What ``whole``, the morph at t, has of the source and of the target."""
    count = len(morph.source) if t < 1 else 0
    index = torch.arange(len(whole), device=whole.means.device)
    return whole.select(index[:count]), whole.select(index[count:])


def _laid_out(
    columns: Sequence[Sequence[Pixels]],
    titles: Sequence[str],
    rows: Sequence[str],
    background: Colour,
) -> Pixels:
    height, width = columns[0][0].shape[:2]
    size = max(11, round(height / 18))
    gap, head = max(2, size // 4), 2 * size
    paper = tuple(round(255 * value) for value in background)
    ink = (30, 30, 34) if sum(paper) > 380 else (236, 234, 230)
    font = ImageFont.load_default(size)
    side = round(1.7 * size) if rows else 0
    sheet = Image.new(
        "RGB",
        (
            side + len(columns) * (width + gap) + gap,
            head + len(columns[0]) * (height + gap),
        ),
        paper,
    )
    pen = ImageDraw.Draw(sheet)
    for i, (title, column) in enumerate(zip(titles, columns, strict=True)):
        left = side + gap + i * (width + gap)
        pen.text((left + width / 2, head / 2), title, ink, font, anchor="mm")
        for k, picture in enumerate(column):
            sheet.paste(Image.fromarray(picture), (left, head + k * (height + gap)))
    for k in range(len(columns[0]) if rows else 0):
        label = Image.new("RGB", (height, side), paper)
        ImageDraw.Draw(label).text(
            (height / 2, side / 2), rows[k % len(rows)], ink, font, anchor="mm"
        )
        turned = label.transpose(Image.Transpose.ROTATE_90)
        sheet.paste(turned, (gap // 2, head + k * (height + gap)))
    return np.asarray(sheet)
