"""Streamlines: the velocity field of a flow, seen on the object it moves.

Drawn by pyvista, off the screen unless asked otherwise; without a display VTK draws through EGL
or OSMesa, graphics processor or none.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from ctypes.util import find_library
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from renderer import Camera, to_bytes
from splatmorph.errors import MissingExtraError, OptionError, WriteError
from splatmorph.geometry.harmonics import SH0
from splatmorph.geometry.spreading import farthest
from splatmorph.io.atomic import atomic_write
from splatmorph.rendering import rasterize, renderer_arrays
from splatmorph.view.colour_bar import colour_bar
from splatmorph.view.subject import Subject, thin

STEPS = 48
"""Points of a streamline over the whole morph."""
CLOUD = 9000
"""Points that stand for the source where the scene can be turned."""
PALENESS = 0.45
"""How far the object is mixed with the paper, so that the lines stand out."""
DEPTH_MARGIN = 0.06
"""How far behind the surface a line may begin and still be drawn, as a part of the radius."""
PAPER, INK, QUIET = "white", "#26272b", "#8d8e96"
SOURCE_COLOUR, TARGET_COLOUR = "#13807c", "#c8741a"
COLOURINGS = {"speed": "speed (units per t)", "det": "log det J"}
COLOUR_MAPS = {"speed": "viridis", "det": "RdBu_r"}

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Streamlines:
    """Paths of points along a flow while t goes from 0 to 1, and before."""

    paths: Array
    """(m, STEPS, 3) world units."""
    tails: Array
    """(m, STEPS, 3) the same lines upstream, t from -1 to 0: where the field comes from."""
    values: Array
    """(m, STEPS) what the tubes are coloured by."""
    colouring: str
    """A name of ``COLOURINGS``."""
    marked: NDArray[np.bool_]
    """(m,) which of them begin at landmarks."""

    def select(self, kept: NDArray[np.bool_]) -> Streamlines:
        """The lines where ``kept`` (m,) is true."""
        return Streamlines(
            self.paths[kept],
            self.tails[kept],
            self.values[kept],
            self.colouring,
            self.marked[kept],
        )


@torch.no_grad()
def trace(subject: Subject, *, seeds: int = 240, colouring: str = "speed") -> Streamlines:
    """Streamlines from the source's landmarks and from ``seeds`` splats of its surface.

    The splats are picked spread out: each next one is the farthest from those before, among the
    visible ones that cover most.

    Raises:
        OptionError: an unknown ``colouring``, or no landmark and no seed.
    """
    if colouring not in COLOURINGS:
        raise OptionError(f"colour '{colouring}' is not one of: {', '.join(COLOURINGS)}")
    flow, source = subject.morph.flow, subject.morph.source
    surface = source.means[thin(source, CLOUD)].double()
    seeded = surface[farthest(surface.numpy(force=True), seeds, first=0)]
    starts = torch.cat([subject.source_points.to(surface), seeded])
    if not len(starts):
        raise OptionError("no landmarks and no seeds: nothing to draw streamlines from")
    times = np.linspace(0, 1, STEPS).tolist()
    tails = flow.trajectory(starts, np.linspace(-1, 0, STEPS).tolist())
    if colouring == "speed":
        paths = flow.trajectory(starts, times)
        speeds = (paths[2:] - paths[:-2]).norm(dim=2) * ((STEPS - 1) / 2)
        values = torch.cat([speeds[:1], speeds, speeds[-1:]])
    else:
        paths, jacobians = flow.trajectory_jacobian(starts, times)
        values = torch.linalg.det(jacobians).clamp_min(1e-3).log()
    return Streamlines(
        paths.transpose(0, 1).numpy(force=True),
        tails.transpose(0, 1).numpy(force=True),
        values.T.numpy(force=True),
        colouring,
        np.arange(len(starts)) < len(subject.source_points),
    )


def save_lines(path: Path, lines: Streamlines) -> None:
    """Write the streamlines as VTK polylines (.vtp), for ParaView."""
    with atomic_write(path) as partial:
        _polylines(lines).save(partial)


def picture(
    subjects: Sequence[Subject], lines: Sequence[Streamlines], view: Camera
) -> NDArray[np.uint8]:
    """Flows side by side over pale pictures of their sources, all seen by the same ``view``.

    Lines that begin behind the object are left out. Returns (height, panels × width + the colour
    bar's, 3) uint8.

    Raises:
        WriteError: there is nothing here to draw with.
    """
    backdrops, shown = [], []
    for subject, traced in zip(subjects, lines, strict=True):
        behind, visible = _backdrop(subject, traced, view)
        backdrops.append(behind)
        shown.append(traced.select(visible))
    limits = _limits(lines)
    with _scene(subjects, shown, limits, view, window=False, clouds=False) as plotter:
        over = plotter.screenshot(return_img=True, transparent_background=True) / 255.0
    cover = over[..., 3:]
    drawn = to_bytes(over[..., :3] * cover + np.concatenate(backdrops, axis=1) * (1 - cover))
    colouring = lines[0].colouring
    bar = colour_bar(
        COLOURINGS[colouring], COLOUR_MAPS[colouring], (limits[0], limits[1]), view.height, INK
    )
    return np.concatenate([drawn, bar], axis=1)


def show(
    subjects: Sequence[Subject],
    lines: Sequence[Streamlines],
    view: Camera,
    page: Path | None = None,
) -> None:
    """The same as a scene to turn round, the splats as points: an HTML ``page``, else a window.

    Raises:
        WriteError: there is no display, or nothing here to draw with.
        MissingExtraError: pyvista's packages for pages are not installed.
    """
    limits = _limits(lines)
    window = page is None
    with _scene(subjects, lines, limits, view, window=window, clouds=True) as plotter:
        if page is None:
            plotter.show()
            return
        with atomic_write(page) as partial:
            try:
                plotter.export_html(partial)
            except ImportError as error:
                raise MissingExtraError("trame", "view", "a page of streamlines") from error


def _backdrop(
    subject: Subject, lines: Streamlines, view: Camera
) -> tuple[Array, NDArray[np.bool_]]:
    """A pale picture of the source, and which of the lines begin in front of it."""
    means, quats, scales, opacities, sh = renderer_arrays(subject.morph.source)
    rgb, alpha, depth = rasterize(
        means,
        quats,
        scales,
        opacities,
        sh,
        view.viewmat,
        view.K,
        view.width,
        view.height,
        background=(1, 1, 1),
    )
    starts = lines.paths[:, 0] @ view.viewmat[:3, :3].T + view.viewmat[:3, 3]
    pixels = starts[:, :2] / starts[:, 2:] * view.K[0, 0] + view.K[:2, 2]
    column, row = pixels.astype(int).clip(0, [view.width - 1, view.height - 1]).T
    surface = np.asarray(depth)[row, column] + DEPTH_MARGIN * subject.bounds().radius
    visible = (np.asarray(alpha)[row, column] < 0.5) | (starts[:, 2] < surface)
    return PALENESS + (1 - PALENESS) * np.asarray(rgb, float).clip(0, 1), visible


@contextlib.contextmanager
def _scene(
    subjects: Sequence[Subject],
    lines: Sequence[Streamlines],
    limits: list[float],
    view: Camera,
    *,
    window: bool,
    clouds: bool,
) -> Iterator[Any]:
    """A plotter with everything in it, every panel seen by ``view``."""
    _choose_window(window)
    import pyvista

    columns = len(subjects)
    plotter: Any = pyvista.Plotter(
        off_screen=not window,
        shape=(1, columns),
        border=False,
        window_size=[columns * view.width, view.height],
    )
    try:
        plotter.set_background(PAPER)
        for column, (subject, traced) in enumerate(zip(subjects, lines, strict=True)):
            plotter.subplot(0, column)
            coloured = _add_lines(plotter, subject, traced, limits)
            if clouds and coloured is not None and not plotter.scalar_bars:
                _add_bar(plotter, coloured, traced.colouring, view.height)
            if clouds:
                _add_cloud(plotter, subject)
            flow = subject.morph.flow.kind
            names = f"{subject.source_name} to {subject.target_name}, "
            plotter.add_text(
                flow if columns > 1 else names + flow,
                position=(0.04, 0.93),
                viewport=True,
                font_size=max(6, view.height // 75),
                color=INK,
            )
        plotter.link_views()
        _stand(plotter.camera, view, subjects[0].bounds().center)
        for column in range(columns):
            plotter.subplot(0, column)
            plotter.renderer.ResetCameraClippingRange()
        yield plotter
    finally:
        plotter.close()


def _choose_window(visible: bool) -> None:
    """Make sure VTK has something to draw with: where it has not, it ends the whole process."""
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform != "linux" or display:
        return
    if visible:
        raise WriteError("no display to open a window on: write a picture to draw without one")
    for library, window in (("EGL", "vtkEGLRenderWindow"), ("OSMesa", "vtkOSOpenGLRenderWindow")):
        if find_library(library):
            os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", window)
            return
    raise WriteError(
        "drawing without a display needs EGL or OSMesa: run  apt-get install libegl1 "
        "libegl-mesa0, or write the lines as a .vtp"
    )


def _add_lines(plotter: Any, subject: Subject, lines: Streamlines, limits: list[float]) -> Any:
    """Add them; returns the mapper of their colours, None where nothing moves."""
    import pyvista

    radius = subject.bounds().radius
    tails = _lines(lines.tails).tube(radius=0.0012 * radius, n_sides=6)
    tubes = _polylines(lines).tube(radius=0.0034 * radius, n_sides=10)
    # Where nothing moves, lines have no length and tubes no points.
    if tails.n_points:
        plotter.add_mesh(tails, color=QUIET, lighting=False)
    coloured = None
    if tubes.n_points:
        coloured = plotter.add_mesh(
            tubes,
            scalars=lines.colouring,
            cmap=COLOUR_MAPS[lines.colouring],
            clim=limits,
            show_scalar_bar=False,
            smooth_shading=True,
        ).mapper
    marks = lines.paths[lines.marked]
    for points, colour in ((marks[:, 0], SOURCE_COLOUR), (marks[:, -1], TARGET_COLOUR)):
        if len(points):
            ball = pyvista.Sphere(radius=0.0085 * radius)
            balls = pyvista.PolyData(points).glyph(geom=ball, scale=False, orient=False)
            plotter.add_mesh(balls, color=colour, smooth_shading=True)
    return coloured


def _add_bar(plotter: Any, coloured: Any, colouring: str, height: int) -> None:
    plotter.add_scalar_bar(
        mapper=coloured,
        title=COLOURINGS[colouring] + "\n",
        color=INK,
        n_labels=3,
        fmt="%.2g",
        width=0.5,
        height=0.06,
        position_x=0.25,
        position_y=0.03,
        title_font_size=max(8, height // 55),
        label_font_size=max(8, height // 62),
    )


def _add_cloud(plotter: Any, subject: Subject) -> None:
    import pyvista

    for splats, most, opacity in (
        (subject.morph.source, CLOUD, 1.0),
        (subject.morph.target, CLOUD // 3, 0.35),
    ):
        kept = splats.select(thin(splats, most))
        colours = (0.5 + SH0 * kept.sh[:, 0]).clamp(0, 1).numpy(force=True)
        plotter.add_mesh(
            pyvista.PolyData(kept.means.double().numpy(force=True)),
            scalars=to_bytes(PALENESS + (1 - PALENESS) * colours),
            rgb=True,
            opacity=opacity,
            point_size=5,
            render_points_as_spheres=True,
            lighting=False,
        )


def _lines(paths: Array) -> Any:
    """(m, steps, 3) as VTK polylines."""
    import pyvista

    count, steps, _ = paths.shape
    index = np.arange(count * steps).reshape(count, steps)
    cells = np.column_stack([np.full(count, steps), index])
    return pyvista.PolyData(paths.reshape(-1, 3), lines=cells.ravel())


def _polylines(lines: Streamlines) -> Any:
    made = _lines(lines.paths)
    made[lines.colouring] = lines.values.ravel()
    made["t"] = np.tile(np.linspace(0, 1, STEPS), len(lines.paths))
    return made


def _limits(lines: Sequence[Streamlines]) -> list[float]:
    """One colour scale for all panels; that of log det is even about 0, where nothing changes."""
    values = np.concatenate([one.values.ravel() for one in lines])
    low, high = np.quantile(values, [0.005, 0.995])
    if lines[0].colouring == "det":
        high = max(abs(low), abs(high), 1e-6)
        low = -high
    return [float(low), float(max(high, low + 1e-12))]


def _stand(camera: Any, view: Camera, focus: Array) -> None:
    camera.position, camera.focal_point = view.position.tolist(), focus.tolist()
    camera.up = (-view.viewmat[1, :3]).tolist()
    camera.view_angle = float(np.degrees(2 * np.arctan(view.height / 2 / view.K[1, 1])))
