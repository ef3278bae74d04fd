"""Strokes of paint in space, and the Gaussians they become."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import SH0
from splatmorph.samples.implicit import Array, length

METRES = 1e-3
SH1 = 0.4886025119029199


@dataclass(frozen=True)
class Strokes:
    """n flat or elongated marks before lighting, in millimetres."""

    points: Array
    """(3, n) centers."""
    normals: Array
    """(3, n) unit normals: the short axis, and what the light sees."""
    along: Array
    """(3, n) unit tangents: the first axis."""
    sizes: Array
    """(3, n) standard deviations along the tangent, across it and along the normal."""
    colors: Array
    """(3, n) albedo, sRGB."""
    gloss: Array
    """(n,) strength of the sheen, 0 dull to 1 wet."""
    light: Array
    """(n,) share of the light that reaches the stroke within its own material (hair, folds)."""

    def __len__(self) -> int:
        return int(self.points.shape[1])

    def select(self, index: NDArray[np.bool_] | NDArray[np.intp]) -> Strokes:
        return Strokes(**{name: value[..., index] for name, value in vars(self).items()})

    @staticmethod
    def concatenate(parts: Sequence[Strokes]) -> Strokes:
        return Strokes(
            **{
                name: np.concatenate([getattr(s, name) for s in parts], -1)
                for name in vars(parts[0])
            }
        )


def flat(
    points: Array, normals: Array, size: Array, colors: Array, gloss: float | Array
) -> Strokes:
    """Round flakes lying on a surface."""
    n = points.shape[1]
    sizes = np.stack([size, size, 0.11 * size])
    along = perpendicular(normals)
    shine = np.broadcast_to(np.asarray(gloss, np.float32), (n,))
    return Strokes(points, normals, along, sizes, colors, shine, np.ones(n, np.float32))


def perpendicular(v: Array) -> Array:
    """(3, n) unit vectors at right angles to ``v``."""
    helper = np.where(np.abs(v[1]) < 0.9, 1, 0).astype(np.float32)
    axis = np.stack([1 - helper, helper, np.zeros_like(helper)])
    out = np.cross(v, axis, axis=0)
    return out / length(out)


def tangential(v: Array, normals: Array) -> Array:
    """``v`` laid into the surface with the given normals, unit length."""
    out = v - normals * (v * normals).sum(0)
    return out / np.maximum(length(out), 1e-6)


def to_gaussians(strokes: Strokes, base: Array, slope: Array, opacity: float = 0.985) -> Gaussians:
    """Gaussians of degree 1 whose colour is ``base + slope · v``, v the unit vector to the eye.

    ``base`` is (3, n) sRGB, ``slope`` (3, 3, n): channel, axis. The sign of v is turned because
    the basis is evaluated along the ray, from the eye to the splat.
    """
    across = np.cross(strokes.normals, strokes.along, axis=0)
    axes = np.stack([strokes.along, across, strokes.normals], axis=1)
    quats = Rotation.from_matrix(axes.transpose(2, 0, 1)).as_quat(canonical=True, scalar_first=True)
    ray = -slope / SH1
    sh = np.stack([(base - 0.5) / SH0, -ray[:, 1], ray[:, 2], -ray[:, 0]])

    def tensor(values: NDArray[np.floating]) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))

    logit = float(np.log(opacity / (1 - opacity)))
    return Gaussians(
        means=tensor(strokes.points.T * METRES),
        quats=tensor(quats),
        log_scales=tensor(np.log(strokes.sizes.T * METRES)),
        opacity_logits=torch.full((len(strokes),), logit),
        sh=tensor(sh.transpose(2, 0, 1)),
        up="y",
    )
