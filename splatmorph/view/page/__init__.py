"""The page: one HTML file that shows splats and their morphs in any browser, offline.

Viewer and data are one file. Its Content-Security-Policy lets our own script run, by its hash,
and pictures that the page itself holds, and nothing else: no other script, no connection.
"""

from __future__ import annotations

import base64
import html
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from PIL import Image

from splatmorph._version import __version__
from splatmorph.errors import OptionError
from splatmorph.gaussians import FAINTEST_DRAWN, Gaussians
from splatmorph.io.atomic import atomic_write
from splatmorph.morph.ramps import DEFAULT_RAMP
from splatmorph.rendering import render
from splatmorph.view.limits import MAX_SPLATS
from splatmorph.view.page.coding import along_curve, one_block
from splatmorph.view.page.joining import digest, filled, joined, read_text
from splatmorph.view.page.pack import first_camera, pack
from splatmorph.view.scene import Scene
from splatmorph.view.subject import thin

POSTER_SIZE = 640
"""Pixels a side of the picture that is seen while the splats are unpacked."""
SCRIPTS = (
    "scene.js",
    "camera.js",
    "shaders.js",
    "splats.js",
    "overlay.js",
    "hands.js",
    "player.js",
    "keep.js",
    "main.js",
)


@dataclass(frozen=True)
class PageReport:
    """What became of the splats on their way into the page."""

    splats: int
    """Splats in the page, all sides."""
    visible: int
    """Splats of the inputs that any rasterizer would draw; more than ``splats``: thinned out."""
    knots: int
    error_px: float
    """The largest distance of a splat from its true place, in a picture 1080 pixels high."""
    size: int
    """Bytes of the file."""

    @property
    def thinned(self) -> bool:
        """Whether visible splats were left out."""
        return self.splats < self.visible


def write_page(
    path: str | Path,
    scene: Scene,
    *,
    up: str = "y",
    background: tuple[float, float, float] | None = None,
    max_splats: int = MAX_SPLATS,
) -> PageReport:
    """Write ``scene`` as one self-contained HTML page.

    Arguments:
        up: the axis that is up, as ``renderer.orbit`` takes it.
        background: RGB in [0, 1]; None: quiet, dark or light as the reader's system is.
        max_splats: thin all sides out to this many splats together, those that cover most
            staying.

    Raises:
        OptionError: ``max_splats`` below 2.
        WriteError: the file can't be written.
    """
    if max_splats < 2:
        raise OptionError(f"max_splats is {max_splats}, expected at least 2")
    visible = [int((side.opacities >= FAINTEST_DRAWN).sum()) for side in scene.splats]
    share = min(1.0, max_splats / max(1, sum(visible)))
    kept = [
        _in_order(side, thin(side, max(1, int(share * count))))
        for side, count in zip(scene.splats, visible, strict=True)
    ]
    counts = [len(index) for index in kept]
    packed = pack(scene, kept, up)
    report = PageReport(sum(counts), sum(visible), packed.knots, packed.error_px, 0)
    tables, payload = one_block(packed.tables)
    told = {
        **packed.facts,
        "tables": tables,
        "splats": [
            {"name": name, "count": count} for name, count in zip(scene.names, counts, strict=True)
        ],
        "ramp": scene.legs[0].morph.ramp if scene.legs else DEFAULT_RAMP,
        "background": _hex(background),
        "facts": _facts(scene, counts, report),
        "about": _about(scene, report),
    }
    # File names may hold bytes that are no text.
    page = _page(scene.title, told, _poster(scene, up), payload).encode(errors="replace")
    with atomic_write(path) as partial:
        partial.write_bytes(page)
    return replace(report, size=len(page))


def _in_order(splats: Gaussians, index: torch.Tensor) -> torch.Tensor:
    """The same indices, near splats near in memory, so that they pack well."""
    order = along_curve(splats.means[index].double().numpy(force=True))
    return index[torch.from_numpy(order)]


def _poster(scene: Scene, up: str) -> str:
    """The first picture as a data URL, transparent where nothing is."""
    pixels = render(scene.splats[0], first_camera(scene, up, POSTER_SIZE), background=None)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "WEBP", quality=80, method=4)
    return "data:image/webp;base64," + base64.b64encode(stream.getvalue()).decode()


def _page(title: str, scene: Mapping[str, object], poster: str, payload: str) -> str:
    style = read_text(__package__, "style.css")
    script = joined((__package__, name) for name in SCRIPTS)
    policy = (
        f"default-src 'none'; script-src '{digest(script)}'; style-src '{digest(style)}'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
    parts = {
        "version": __version__,
        "policy": policy,
        "title": html.escape(title),
        "style": style,
        "script": script,
        # JSON in a page: nothing in it may end the element that holds it.
        "scene": json.dumps(scene, allow_nan=False).replace("<", "\\u003c"),
        "poster": poster,
        "payload": payload,
    }
    return filled(read_text(__package__, "index.html"), parts)


def _hex(colour: tuple[float, float, float] | None) -> str | None:
    if colour is None:
        return None
    return "#" + "".join(f"{round(255 * min(max(value, 0), 1)):02x}" for value in colour)


def _facts(scene: Scene, counts: Sequence[int], report: PageReport) -> str:
    splats = " + ".join(map(_grouped, counts)) + " splats"
    if report.thinned:
        splats += f", thinned out from {_grouped(report.visible)}"
    parts = [splats]
    marks = [str(len(leg.landmark_names)) for leg in scene.legs if leg.landmark_names]
    if marks:
        parts.append(f"{' + '.join(marks)} landmarks")
    return " · ".join(parts)


def _grouped(count: int) -> str:
    return f"{count:,}".replace(",", "\u202f")


def _about(scene: Scene, report: PageReport) -> str:
    parts = [f"Made by splatmorph {__version__}."]
    if scene.legs:
        morph = scene.legs[0].morph
        shape = "shapes kept" if morph.covariance == "fixed" else "shapes carried by the flow"
        parts.append(
            f"Flow {morph.flow.kind}, {shape}. Every splat is within {report.error_px:.2f} pixels "
            f"of its true path in a picture 1080 pixels high ({report.knots} knots)."
        )
    if max(side.sh_degree for side in scene.splats) > 1:
        parts.append("Colours by the harmonics of degree 0 and 1.")
    return " ".join(parts)
