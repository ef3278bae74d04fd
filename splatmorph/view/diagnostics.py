"""Diagnostics of a fit in one figure: did it converge, what did it miss, where does it fold."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from splatmorph.errors import OptionError, RunError
from splatmorph.io.atomic import atomic_write
from splatmorph.io.reading import read_text, reading
from splatmorph.runs.run import HISTORY
from splatmorph.view.subject import Subject, thin

Array = NDArray[np.float64]

INK, QUIET, GOOD, BAD = "#26272b", "#8d8e96", "#13807c", "#c8741a"
NAMED = 24
"""Landmarks that the bar chart names: the worst."""
SAMPLE = 8000
CELLS = 24
POINTS = 97
"""Points along a grid line, so that it bends smoothly."""
PLANES = ((0, 1), (2, 1), (0, 2))
"""The axes across and up."""
AXES = "xyz"
FORMATS = (".png", ".svg", ".pdf")


@dataclass(frozen=True)
class History:
    """The landmark error of a fit, step by step."""

    steps: Sequence[float]
    mse: Sequence[float]
    """Frame units squared."""


def read_history(folder: Path) -> History:
    """The history of a run's (first) flow; empty where the fit left none.

    Raises:
        ReadError, RunError: the file is damaged.
    """
    path = folder / HISTORY
    if not path.exists():
        return History((), ())
    text = read_text(path)
    with reading(path, "history", error=RunError, remedy="fit again"):
        table = csv.DictReader(io.StringIO(text, newline=""))
        rows = [row for row in table if row["leg"] == "0"]
        return History([float(row["step"]) for row in rows], [float(row["mse"]) for row in rows])


@torch.no_grad()
def determinants(subject: Subject) -> Array:
    """(m,) det ∂Φ/∂x(·, 1) at splats of the source, those that cover most."""
    source = subject.morph.source
    points = source.means[thin(source, SAMPLE)].double()
    found = torch.linalg.det(subject.morph.flow.jacobian(points, 1.0))
    return np.asarray(found.numpy(force=True))


def draw_diagnostics(
    path: Path, subject: Subject, errors: Mapping[str, float], history: History
) -> None:
    """Draw loss history, landmark errors by name, det ∂Φ/∂x and the warped grid into one figure.

    Arguments:
        path: a .png, .svg or .pdf.
        errors: world units, by landmark name, as the fit's report has them.

    Raises:
        OptionError: another extension.
        WriteError: the file can't be written.
    """
    from matplotlib.figure import Figure

    if path.suffix.lower() not in FORMATS:
        raise OptionError(f"{path}: diagnostics are drawn as {', '.join(FORMATS)}")
    figure = Figure(figsize=(15, 9.5), layout="constrained")
    figure.suptitle(
        _plain(f"{subject.title}   ({subject.morph.flow.kind})"), color=INK, fontsize=15
    )
    rows: Any = figure.subfigures(2, 1, height_ratios=(1, 1.15))
    panels = rows[0].subplots(1, 3, width_ratios=(1, 1.5, 1))
    _history(panels[0], history)
    _errors(panels[1], errors)
    _determinants(panels[2], determinants(subject))
    for panel, plane in zip(rows[1].subplots(1, 3), PLANES, strict=True):
        _grid(panel, subject, plane)
    with atomic_write(path) as partial:
        figure.savefig(partial, dpi=110)


def _plain(text: str) -> str:
    """Text that matplotlib sets as it is: a dollar would begin mathematics."""
    return text.replace("$", r"\$")


def _dress(panel: Any, title: str, across: str = "", up: str = "") -> None:
    panel.set_title(title, loc="left", color=INK, fontsize=11)
    panel.set_xlabel(across, color=QUIET)
    panel.set_ylabel(up, color=QUIET)
    panel.tick_params(colors=QUIET, labelsize=8)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        panel.spines[side].set_color("#c9cad0")


def _say(panel: Any, text: str) -> None:
    panel.text(0.5, 0.5, text, ha="center", va="center", color=QUIET, transform=panel.transAxes)
    panel.set_axis_off()


def _history(panel: Any, history: History) -> None:
    _dress(panel, "Landmark error while fitting", "step", "mean square, frame units")
    if not history.steps:
        return _say(panel, "no history was kept")
    best = np.minimum.accumulate(history.mse)
    panel.semilogy(history.steps, history.mse, color=QUIET, lw=0.8, label="each step")
    panel.semilogy(history.steps, best, color=GOOD, lw=1.8, label="best so far")
    panel.legend(frameon=False, fontsize=8, labelcolor=INK)


def _errors(panel: Any, errors: Mapping[str, float]) -> None:
    _dress(panel, "Landmarks missed by", up="world units")
    if not errors:
        return _say(panel, "no landmarks")
    worst = sorted(errors.items(), key=lambda item: -item[1])[:NAMED]
    names, values = zip(*worst, strict=True)
    panel.bar(range(len(worst)), values, color=[BAD, *[GOOD] * (len(worst) - 1)], width=0.7)
    short = [_plain(name if len(name) <= 18 else f"{name[:17]}…") for name in names]
    panel.set_xticks(range(len(worst)), short, rotation=60, ha="right", rotation_mode="anchor")
    median = float(np.median(list(errors.values())))
    panel.axhline(median, color=INK, lw=0.8, ls=":")
    panel.text(
        0.99,
        0.97,
        f"median of all {len(errors)}: {median:.2g}",
        ha="right",
        va="top",
        fontsize=8,
        color=INK,
        transform=panel.transAxes,
    )


def _determinants(panel: Any, found: Array) -> None:
    _dress(panel, "Volume change det ∂Φ/∂x at t = 1", "1: kept    below 0: folded", "splats")
    low, high = np.quantile(found, [0.002, 0.998])
    edges = np.linspace(min(low, 0.9), max(high, 1.1), 60)
    panel.hist(np.clip(found, edges[0], edges[-1]), edges, color=GOOD)
    panel.axvline(1, color=INK, lw=0.8, ls=":")
    folded = int((found <= 0).sum())
    note = f"{found.min():.2f} to {found.max():.2f}"
    panel.text(
        0.99,
        0.97,
        f"{note}\n{folded} folded" if folded else note,
        ha="right",
        va="top",
        fontsize=8,
        color=BAD if folded else INK,
        transform=panel.transAxes,
    )


@torch.no_grad()
def _grid(panel: Any, subject: Subject, plane: tuple[int, int]) -> None:
    """A plane through the middle of the object, carried to t = 1 and seen straight on."""
    across, up = plane
    title = f"The {AXES[across]}{AXES[up]} plane, warped to t = 1"
    _dress(panel, title, AXES[across], AXES[up])
    bounds = subject.bounds()
    half = 0.9 * bounds.radius
    along, levels = np.linspace(-half, half, POINTS), np.linspace(-half, half, CELLS + 1)
    lines = np.tile(bounds.center, (2, CELLS + 1, POINTS, 1))
    for k, (running, fixed) in enumerate(((across, up), (up, across))):
        lines[k, ..., running] += along
        lines[k, ..., fixed] += levels[:, None]
    moved = subject.morph.flow(torch.from_numpy(lines.reshape(-1, 3)), 1.0).numpy(force=True)
    for line in moved.reshape(-1, POINTS, 3):
        panel.plot(line[:, across], line[:, up], color=QUIET, lw=0.6)
    _marks(panel, subject, across, up)
    panel.set_aspect("equal")
    panel.set_xlim(bounds.center[across] - 1.15 * half, bounds.center[across] + 1.15 * half)
    panel.set_ylim(bounds.center[up] - 1.15 * half, bounds.center[up] + 1.15 * half)


def _marks(panel: Any, subject: Subject, across: int, up: int) -> None:
    sides = (subject.source_points, GOOD), (subject.target_points, BAD)
    for points, colour in sides:
        panel.scatter(*points[:, [across, up]].T.numpy(force=True), s=5, color=colour, zorder=3)
