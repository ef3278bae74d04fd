"""The page: one HTML file that shows a morph in any browser, offline.

Viewer and data are one file. Its Content-Security-Policy lets our own script run, by its hash,
and nothing else: no other script, no connection.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splatmorph._version import __version__
from splatmorph.errors import OptionError
from splatmorph.gaussians import FAINTEST_DRAWN, Gaussians
from splatmorph.io.atomic import atomic_write
from splatmorph.view.page.pack import pack
from splatmorph.view.subject import Subject, thin

MAX_SPLATS = 200_000
"""Default of the most splats a page carries: what a laptop sorts and draws at every frame."""
SCRIPTS = ("scene.js", "camera.js", "splats.js", "overlay.js", "hands.js", "main.js")


@dataclass(frozen=True)
class PageReport:
    """What became of the splats on their way into the page."""

    splats: int
    """Splats in the page, both sides."""
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
    subject: Subject,
    *,
    up: str = "y",
    background: tuple[float, float, float] | None = None,
    max_splats: int = MAX_SPLATS,
) -> PageReport:
    """Write ``subject`` as one self-contained HTML page.

    Arguments:
        up: the axis that is up, as ``renderer.orbit`` takes it.
        background: RGB in [0, 1]; None: a quiet dark grey.
        max_splats: thin both sides out to this many splats together, those that cover most
            staying.

    Raises:
        OptionError: ``max_splats`` below 2.
        WriteError: the file can't be written.
    """
    if max_splats < 2:
        raise OptionError(f"max_splats is {max_splats}, expected at least 2")
    inputs = (subject.morph.source, subject.morph.target)
    visible = [int((side.opacities >= FAINTEST_DRAWN).sum()) for side in inputs]
    keep = min(1.0, max_splats / max(1, sum(visible)))
    kept = [
        thin(side, max(1, int(keep * count))) for side, count in zip(inputs, visible, strict=True)
    ]
    source, target = (side.select(index) for side, index in zip(inputs, kept, strict=True))
    packed = pack(subject, (kept[0], kept[1]), up)
    where, payload = _one_block(packed.arrays)
    report = PageReport(len(source) + len(target), sum(visible), packed.knots, packed.error_px, 0)
    scene = {
        **packed.facts,
        "arrays": where,
        "source": {"name": subject.source_name, "count": len(source)},
        "target": {"name": subject.target_name, "count": len(target)},
        "ramp": subject.morph.ramp,
        "background": _hex(background),
        "facts": _facts(subject, source, target, report),
        "about": _about(subject, report),
    }
    page = _page(subject.title, scene, payload)
    with atomic_write(path) as partial:
        partial.write_text(page, encoding="utf-8")
    return PageReport(**{**vars(report), "size": len(page.encode())})


def _one_block(arrays: Mapping[str, NDArray[np.generic]]) -> tuple[dict[str, object], str]:
    """Where each array lies, and all of them deflated and in base64."""
    where: dict[str, object] = {}
    block = bytearray()
    for name, array in arrays.items():
        block += b"\0" * (-len(block) % 4)
        where[name] = [array.dtype.str[1:], len(block), array.size]
        block += np.ascontiguousarray(array).tobytes()
    return where, base64.b64encode(zlib.compress(block, 9)).decode()


def _page(title: str, scene: Mapping[str, object], payload: str) -> str:
    here = files(__package__)
    style = here.joinpath("style.css").read_text(encoding="utf-8")
    script = "\n".join(here.joinpath(name).read_text(encoding="utf-8") for name in SCRIPTS)
    policy = (
        f"default-src 'none'; script-src '{_digest(script)}'; style-src '{_digest(style)}'; "
        "base-uri 'none'; form-action 'none'"
    )
    parts = {
        "version": __version__,
        "policy": policy,
        "title": html.escape(title),
        "style": style,
        "script": script,
        # JSON in a page: nothing in it may end the element that holds it.
        "scene": json.dumps(scene, allow_nan=False).replace("<", "\\u003c"),
        "payload": payload,
    }
    skeleton = here.joinpath("index.html").read_text(encoding="utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], skeleton)


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _hex(colour: tuple[float, float, float] | None) -> str | None:
    if colour is None:
        return None
    return "#" + "".join(f"{round(255 * min(max(value, 0), 1)):02x}" for value in colour)


def _facts(subject: Subject, source: Gaussians, target: Gaussians, report: PageReport) -> str:
    parts = [f"{len(source):,} + {len(target):,} splats".replace(",", "\u202f")]
    if report.thinned:
        parts[0] += f", thinned out from {report.visible:,}".replace(",", "\u202f")
    if subject.landmark_names:
        parts.append(f"{len(subject.landmark_names)} landmarks")
    return " · ".join(parts)


def _about(subject: Subject, report: PageReport) -> str:
    shape = "shapes kept" if subject.morph.covariance == "fixed" else "shapes carried by the flow"
    return (
        f"Made by splatmorph {__version__}. Flow {subject.morph.flow.kind}, {shape}. "
        f"Every splat is within {report.error_px:.2f} pixels of its true path in a picture "
        f"1080 pixels high ({report.knots} knots). Colours by the constant harmonic."
    )
