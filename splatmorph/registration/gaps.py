"""Whether two surfaces meet in the middle of a morph, landmarks met or not."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from splatmorph.errors import LandmarkError
from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.similarity import Similarity
from splatmorph.registration.cleaning import without_floaters
from splatmorph.registration.surfaces import surface_points

COUNTERPART = 0.06
"""Radii within which a surface has a counterpart."""


@dataclass(frozen=True)
class Gap:
    """How far apart two surfaces lie, each point to the nearest of the other, both ways."""

    mean: float
    """In the units of the points."""
    alone: float
    """Share of the points whose surface has no counterpart within ``COUNTERPART`` radii."""


def gap_between(a: Tensor, b: Tensor, radius: float) -> Gap:
    """The gap between two surfaces' points (n, 3), (m, 3) of an object of such a radius."""
    one, other = (points.detach().cpu().double().numpy() for points in (a, b))
    there, back = cKDTree(other).query(one)[0], cKDTree(one).query(other)[0]
    far = [float((part > COUNTERPART * radius).mean()) for part in (there, back)]
    return Gap(float(there.mean() + back.mean()) / 2, sum(far) / 2)


def half_time_gap(
    flow: Flow, frame: Similarity, source: Gaussians, target: Gaussians
) -> Gap | None:
    """The gap between Φ(x, 1/2) of the source's surface and Φ(S⁻¹y, -1/2) of the target's.

    ``frame`` is S, source → target; the source's units. None where one shows no solid surface.
    """
    try:
        (a, radius), (b, _) = (surface_points(without_floaters(g)) for g in (source, target))
    except LandmarkError:
        return None
    here = flow(torch.from_numpy(a).float(), 0.5)
    there = flow(frame.inverse()(torch.from_numpy(b)).float(), -0.5)
    return gap_between(here, there, radius)
