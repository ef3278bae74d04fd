"""What exporters call a splat PLY: one table of the layouts we read, one of those we only name.

Every layout that is read becomes Inria's, the one that ``ply.py`` knows: log scales, a logit of
opacity, harmonics. A layout that holds something else than one splat at one moment is refused with
the way to a file that does.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splatmorph.errors import ReadError
from splatmorph.gaussians import FAINTEST_DRAWN
from splatmorph.geometry.harmonics import SH0
from splatmorph.io.packed import FAINTEST

Columns = Mapping[str, NDArray[Any]]

RGB = ("red", "green", "blue")
COLOUR = ("f_dc_0", "f_dc_1", "f_dc_2")
SCALES = ("scale_0", "scale_1", "scale_2")

FLATNESS = 1e-3
"""Thickness of a flat splat beside the shorter of its two sides: it has none, and logs need one."""


@dataclass(frozen=True)
class Dialect:
    """A layout of properties that is read."""

    name: str
    writers: str
    """Who writes it."""
    spoken: Callable[[Collection[str]], bool]
    """Whether these properties are in it."""
    translated: Callable[[Columns], Columns]
    """The same splat in Inria's properties."""


@dataclass(frozen=True)
class Stranger:
    """A layout that is named, not read."""

    name: str
    sign: str
    """A regular expression of a property that no other layout has."""
    way_out: str


def _coloured_by_rgb(columns: Columns) -> Columns:
    """f_dc = (c - 0.5) / SH0, c being a byte over 255 or a float that is in [0, 1] already."""
    translated = {name: values for name, values in columns.items() if name not in RGB}
    for name, channel in zip(COLOUR, RGB, strict=True):
        stored = columns[channel]
        most = np.iinfo(stored.dtype).max if stored.dtype.kind in "ui" else 1
        translated[name] = (stored / most - 0.5) / SH0
    return translated


def _thickened(columns: Columns) -> Columns:
    shorter = np.minimum(columns["scale_0"], columns["scale_1"])
    return {**columns, "scale_2": shorter + np.log(FLATNESS)}


def _smoothed(columns: Columns) -> Columns:
    """Mip-Splatting's eq. 9: the covariance grows by f² I, the opacity shrinks by its volume.

    s' = √(s² + f²), α' = α √(det Σ / det Σ') = α Π s / s'. Where that would leave nothing to see,
    the stored opacities are the shrunk ones already, and stay.
    """
    width = columns["filter_3D"].astype(np.float64)
    scales = np.exp(np.stack([columns[name] for name in SCALES], axis=1).astype(np.float64))
    wider = np.sqrt(scales**2 + width[:, None] ** 2)
    logits = columns["opacity"].astype(np.float64)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        alphas = (scales / wider).prod(axis=1) / (1 + np.exp(-logits))
        shrunk = np.log(alphas) - np.log1p(-alphas)
    # Without a filter the bits stay.
    filtered = (width != 0) & (alphas >= FAINTEST_DRAWN).any()
    smoothed = {name: values for name, values in columns.items() if name != "filter_3D"}
    smoothed["opacity"] = np.where(filtered, shrunk, logits)
    for i, name in enumerate(SCALES):
        smoothed[name] = np.where(width != 0, np.log(wider[:, i]), columns[name])
    return smoothed


DIALECTS = (
    Dialect(
        "colours as red, green, blue",
        "nerfstudio's ns-export --ply-color-mode rgb",
        lambda names: "f_dc_0" not in names and set(RGB) <= set(names),
        _coloured_by_rgb,
    ),
    Dialect(
        "flat splats of two scales",
        "2D Gaussian Splatting and what builds on it",
        lambda names: "scale_1" in names and "scale_2" not in names,
        _thickened,
    ),
    Dialect(
        "a 3D smoothing filter beside the scales",
        "Mip-Splatting, Gaussian Opacity Fields, RaDe-GS",
        lambda names: "filter_3D" in names,
        _smoothed,
    ),
)

STRANGERS = (
    Stranger(
        "the anchors of Scaffold-GS, whose splats a network makes for each view",
        r"f_anchor_feat_\d+|f_offset_\d+",
        "save explicit Gaussians from its trained model first (Octree-GS and HAC keep the same)",
    ),
    Stranger(
        "a splat of many moments (Spacetime Gaussians)",
        r"trbf_center|trbf_scale",
        "save the splat of one moment as a plain PLY from its trainer or player first",
    ),
    Stranger(
        "a splat of many moments (4D Gaussian Splatting)",
        r"scale_t|scaling_t|rot_r_\d+|rotation_r_\d+",
        "save the splat of one moment as a plain PLY from its trainer or player first",
    ),
)

DEFORMATION = "deformation.pth"
"""What lies beside the PLY of 4DGaussians, whose splats a network moves in time."""

STRANGE_FILES = {
    ".lcc": "a scene of XGRIDS: convert it, for example with "
    "npx @playcanvas/splat-transform in.lcc out.ply",
    ".splatv": "a splat of many moments (antimatter15/splaTV): save one moment as .ply",
    ".zip": "an archive: unpack it and give the .ply inside (Luma packs its captures so)",
    ".ckpt": "a training checkpoint: export it as .ply with the trainer (ns-export gaussian-splat)",
    ".pth": "a training checkpoint: export it as .ply with the trainer",
    ".pt": "a training checkpoint: export it as .ply with the trainer",
    ".obj": "a mesh: train or convert it to 3D Gaussians first",
    ".stl": "a mesh: train or convert it to 3D Gaussians first",
    ".fbx": "a mesh: train or convert it to 3D Gaussians first",
    ".las": "a point cloud: train or convert it to 3D Gaussians first",
    ".laz": "a point cloud: train or convert it to 3D Gaussians first",
    ".e57": "a point cloud: train or convert it to 3D Gaussians first",
}
"""What files with these extensions are, and how to come from them to one we read."""


def dialects_of(names: Collection[str]) -> tuple[Dialect, ...]:
    """The dialects of ``DIALECTS`` that a file's properties are in; none for Inria's own."""
    return tuple(dialect for dialect in DIALECTS if dialect.spoken(names))


def translated(columns: Columns, path: str | Path) -> Columns:
    """PLY properties of any known layout as Inria's; ``path`` is for the messages.

    Raises:
        ReadError: a layout that we know to be no splat of one moment.
    """
    for stranger in STRANGERS:
        found = [name for name in columns if re.fullmatch(stranger.sign, name)]
        if found:
            raise ReadError(
                f"{path} holds {stranger.name} (property {found[0]}), expected one plain splat: "
                f"{stranger.way_out}"
            )
    for dialect in dialects_of(columns):
        columns = dialect.translated(columns)
    return columns


def finite_logits(logits: NDArray[Any]) -> NDArray[np.float32]:
    """Opacity logits with ±inf, which are opacities of exactly 1 and 0, a little from them."""
    most = np.float32(np.log((1 - FAINTEST) / FAINTEST))
    narrow = logits.astype(np.float32)
    infinite = np.isinf(narrow)
    return np.where(infinite, np.sign(narrow) * most, narrow) if infinite.any() else narrow
