"""Streamlines: the velocity field of a flow, seen on the object it moves.

Drawn by pyvista, off the screen unless asked otherwise. VTK's wheel brings what it needs to draw
without a display or a graphics processor.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from renderer import Camera, orbit, to_bytes
from splatmorph.errors import OptionError, WriteError
from splatmorph.gaussians import Gaussians
from splatmorph.io.atomic import atomic_write
from splatmorph.view.subject import Subject, footprints, thin

SH0 = 0.28209479177387814
STEPS = 48
"""Points of a streamline over the whole morph."""
BACKGROUND = 4000
"""Splats of each side that stand for the object."""
PAPER, INK = "white", "#26272b"
SOURCE_COLOUR, TARGET_COLOUR = "#13807c", "#c8741a"
COLOURINGS = {"speed": "speed (units per t)", "det": "log det ∂Φ/∂x"}
COLOUR_MAPS = {"speed": "viridis", "det": "RdBu_r"}
FORMATS = (".png", ".jpg", ".html", ".vtp")

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Streamlines:
    """Paths of points along a flow while t goes from 0 to 1."""

    paths: Array
    """(m, STEPS, 3) world units."""
    values: Array
    """(m, STEPS) what the tubes are coloured by."""
    colouring: str
    """A name of ``COLOURINGS``."""
    landmarks: int
    """How many of the paths, the first ones, begin at landmarks."""


@torch.no_grad()
def trace(subject: Subject, *, seeds: int = 160, colouring: str = "speed") -> Streamlines:
    """Streamlines from the source's landmarks and from ``seeds`` splats of its surface.

    The splats are picked spread out: each next one is the farthest from those before, among the
    visible ones that cover most.

    Raises:
        OptionError: an unknown ``colouring``, or no landmark and no seed.
    """
    if colouring not in COLOURINGS:
        raise OptionError(f"colour '{colouring}' is not one of: {', '.join(COLOURINGS)}")
    flow, source = subject.morph.flow, subject.morph.source
    surface = source.means[thin(source, BACKGROUND)].double()
    starts = torch.cat([subject.source_points.to(surface), _spread(surface, seeds)])
    if not len(starts):
        raise OptionError("no landmarks and no seeds: nothing to draw streamlines from")
    times = np.linspace(0, 1, STEPS).tolist()
    if colouring == "speed":
        paths = flow.trajectory(starts, times)
        speeds = (paths[2:] - paths[:-2]).norm(dim=2) * ((STEPS - 1) / 2)
        values = torch.cat([speeds[:1], speeds, speeds[-1:]])
    else:
        paths, jacobians = flow.trajectory_jacobian(starts, times)
        values = torch.linalg.det(jacobians).clamp_min(1e-3).log()
    return Streamlines(
        paths.transpose(0, 1).numpy(force=True),
        values.T.numpy(force=True),
        colouring,
        len(subject.source_points),
    )


def _spread(points: Tensor, count: int) -> Tensor:
    """``count`` of the points (m, 3), each the farthest from those before it."""
    chosen: list[int] = []
    distances = torch.full((len(points),), torch.inf, dtype=points.dtype)
    for _ in range(min(count, len(points))):
        chosen.append(int(distances.argmax()))
        distances = torch.minimum(distances, (points - points[chosen[-1]]).norm(dim=1))
    return points[chosen]


def save_lines(path: Path, lines: Streamlines) -> None:
    """Write the streamlines as VTK polylines (.vtp), for ParaView."""
    with atomic_write(path) as partial:
        _polylines(lines).save(partial)


def draw(
    subjects: Sequence[Subject],
    lines: Sequence[Streamlines],
    path: Path | None,
    *,
    camera: tuple[float, float, str] = (30.0, 10.0, "y"),
    size: tuple[int, int] = (1000, 1000),
) -> None:
    """Draw flows side by side, their cameras linked and their colours on one scale.

    Arguments:
        subjects, lines: what to draw, one a panel.
        path: a .png, .jpg or .html to write; None: a window.
        camera: azimuth and elevation in degrees, and the axis that is up.
        size: of one panel, pixels.

    Raises:
        OptionError: an unknown extension.
        WriteError: the picture can't be drawn or written here.
    """
    kind = path.suffix.lower() if path else None
    if kind is not None and kind not in FORMATS[:3]:
        raise OptionError(f"{path}: expected one of {', '.join(FORMATS)}")
    with _scene(subjects, lines, camera, size, window=path is None) as plotter:
        if path is None:
            plotter.show()
            return
        with atomic_write(path) as partial:
            if kind == ".html":
                _export_html(plotter, partial)
            else:
                plotter.screenshot(partial)


def film(
    subjects: Sequence[Subject],
    lines: Sequence[Streamlines],
    azimuths: Sequence[float],
    *,
    camera: tuple[float, float, str] = (0.0, 10.0, "y"),
    size: tuple[int, int] = (640, 640),
) -> Iterator[NDArray[np.uint8]]:
    """Pictures of the same from one azimuth after another, for a video."""
    _, elevation, up = camera
    with _scene(subjects, lines, camera, size, window=False) as plotter:
        around = subjects[0].bounds()
        views = orbit(around, azimuths, elevation=elevation, up=up, width=size[0], height=size[1])
        for view in views:
            _stand(plotter, view, around.center, len(subjects))
            plotter.render()
            yield to_bytes(plotter.screenshot(return_img=True))


@contextlib.contextmanager
def _scene(
    subjects: Sequence[Subject],
    lines: Sequence[Streamlines],
    camera: tuple[float, float, str],
    size: tuple[int, int],
    *,
    window: bool,
) -> Iterator[Any]:
    """A plotter with everything in it, and the errors of drawing told in one line."""
    import pyvista

    pyvista.OFF_SCREEN = not window
    if window and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise WriteError("no display to open a window on: give -o x.png to draw without one")
    columns = len(subjects)
    try:
        plotter = pyvista.Plotter(
            off_screen=not window,
            shape=(1, columns),
            border=False,
            window_size=[columns * size[0], size[1]],
        )
    except (RuntimeError, OSError) as error:
        raise WriteError(f"VTK can't draw here ({error}): is EGL or OSMesa there?") from error
    try:
        limits = _limits(lines)
        for column, (subject, traced) in enumerate(zip(subjects, lines, strict=True)):
            plotter.subplot(0, column)
            _fill(plotter, subject, traced, limits, several=columns > 1)
        plotter.link_views()
        azimuth, elevation, up = camera
        around = subjects[0].bounds()
        view = orbit(around, [azimuth], elevation=elevation, up=up, width=size[0], height=size[1])
        _stand(plotter, view[0], around.center, columns)
        yield plotter
    finally:
        plotter.close()


def _fill(
    plotter: Any, subject: Subject, lines: Streamlines, limits: list[float], *, several: bool
) -> None:
    import pyvista

    radius = subject.bounds().radius
    plotter.set_background(PAPER)
    for splats in (subject.morph.source, subject.morph.target):
        cloud, colours = _cloud(splats)
        plotter.add_mesh(
            pyvista.PolyData(cloud),
            scalars=colours,
            rgba=True,
            point_size=5,
            render_points_as_spheres=True,
            lighting=False,
        )
    tubes = _polylines(lines).tube(radius=0.004 * radius, n_sides=8)
    plotter.add_mesh(
        tubes,
        scalars=lines.colouring,
        cmap=COLOUR_MAPS[lines.colouring],
        clim=limits,
        show_scalar_bar=False,
        smooth_shading=True,
    )
    plotter.add_scalar_bar(
        title=COLOURINGS[lines.colouring],
        color=INK,
        n_labels=3,
        fmt="%.3g",
        width=0.5,
        height=0.06,
        position_x=0.25,
        position_y=0.03,
        title_font_size=18,
        label_font_size=16,
    )
    marks = lines.paths[: lines.landmarks]
    for points, colour in ((marks[:, 0], SOURCE_COLOUR), (marks[:, -1], TARGET_COLOUR)):
        if len(points):
            plotter.add_mesh(
                pyvista.PolyData(points).glyph(
                    geom=pyvista.Sphere(radius=0.011 * radius), scale=False, orient=False
                ),
                color=colour,
                smooth_shading=True,
            )
    missed = _missed(subject)
    if missed is not None:
        # Where the targets' landmarks are: a rim shows round the end of a path that misses.
        plotter.add_mesh(
            pyvista.PolyData(missed), color=INK, point_size=3, render_points_as_spheres=True
        )
    flow = subject.morph.flow.kind
    title = flow if several else f"{subject.title}   {flow}"
    plotter.add_text(title, position="upper_left", font_size=12, color=INK)


def _missed(subject: Subject) -> Array | None:
    points = subject.target_points
    return points.numpy(force=True) if len(points) else None


def _polylines(lines: Streamlines) -> Any:
    import pyvista

    count, steps, _ = lines.paths.shape
    index = np.arange(count * steps).reshape(count, steps)
    cells = np.column_stack([np.full(count, steps), index])
    made = pyvista.PolyData(lines.paths.reshape(-1, 3), lines=cells.ravel())
    made[lines.colouring] = lines.values.ravel()
    made["t"] = np.tile(np.linspace(0, 1, steps), count)
    return made


def _cloud(splats: Gaussians) -> tuple[Array, NDArray[np.uint8]]:
    """The splats that cover most: where they are, and RGBA, pale so that lines stand out."""
    kept = splats.select(thin(splats, BACKGROUND))
    colours = (0.5 + SH0 * kept.sh[:, 0]).clamp(0, 1).numpy(force=True)
    strength = footprints(kept).sqrt()
    shown = 0.30 * (strength / strength.max()).clamp(0.25, 1).numpy(force=True)
    return kept.means.double().numpy(force=True), to_bytes(np.column_stack([colours, shown]))


def _limits(lines: Sequence[Streamlines]) -> list[float]:
    """One colour scale for all panels; that of log det is even about 0, where nothing changes."""
    values = np.concatenate([one.values.ravel() for one in lines])
    low, high = np.quantile(values, [0.005, 0.995])
    if lines[0].colouring == "det":
        high = max(abs(low), abs(high), 1e-6)
        low = -high
    return [float(low), float(max(high, low + 1e-12))]


def _stand(plotter: Any, view: Camera, focus: Array, columns: int) -> None:
    """Put the cameras of all panels where ``view`` is."""
    for column in range(columns):
        plotter.subplot(0, column)
        camera = plotter.camera
        camera.position, camera.focal_point = view.position.tolist(), focus.tolist()
        camera.up = (-view.viewmat[1, :3]).tolist()
        camera.view_angle = float(np.degrees(2 * np.arctan(view.height / 2 / view.K[1, 1])))
        plotter.renderer.ResetCameraClippingRange()


def _export_html(plotter: Any, path: Path) -> None:
    try:
        plotter.export_html(path)
    except ImportError as error:
        raise OptionError(
            f"a page of streamlines needs pyvista's packages for the browser ({error}): run  "
            "pip install 'pyvista[jupyter]', or write a .png or .vtp"
        ) from error
