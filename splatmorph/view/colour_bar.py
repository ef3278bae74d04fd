"""The colour bar beside a picture."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer import to_bytes

ASPECT = 5
"""Its height in its widths: labels and title fit beside the colours."""


def colour_bar(
    title: str, colour_map: str, limits: tuple[float, float], height: int, ink: str
) -> NDArray[np.uint8]:
    """A strip (height, width, 3) uint8 of the colours from ``limits`` low to high, upwards.

    Arguments:
        title: what is coloured, with its unit.
        colour_map: matplotlib's name of it.
        limits: the values at both ends.
        height: of the strip, pixels.
        ink: of the text, as matplotlib takes it.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    width = 2 * max(1, round(height / ASPECT / 2))
    # A point of text is a pixel, so that it grows with the picture.
    figure = Figure(figsize=(width / 72, height / 72), dpi=72, facecolor="white")
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.12, 0.15, 0.14, 0.7))
    bar = figure.colorbar(ScalarMappable(Normalize(*limits), colour_map), cax=axes)
    bar.outline.set_visible(False)
    bar.set_ticks(np.linspace(*limits, 5).tolist())
    bar.ax.set_yticklabels([f"{value:.2g}" for value in np.linspace(*limits, 5)])
    bar.ax.tick_params(labelsize=height / 42, colors=ink, length=height / 200)
    bar.set_label(title, size=height / 38, color=ink)
    canvas.draw()
    return to_bytes(np.asarray(canvas.buffer_rgba())[..., :3] / 255.0)
