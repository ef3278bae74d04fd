"""Subject: a run opened to be looked at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from renderer import Bounds
from splatmorph.errors import OptionError
from splatmorph.gaussians import FAINTEST_DRAWN, Gaussians
from splatmorph.geometry.similarity import Similarity
from splatmorph.morph import Morph
from splatmorph.rendering import bounds
from splatmorph.runs.run import open_run

NO_POINTS = torch.empty(0, 3, dtype=torch.float64)


@dataclass(frozen=True)
class Subject:
    """A morph, with the names and landmarks that pictures of it show."""

    morph: Morph
    source_name: str = "source"
    target_name: str = "target"
    source_points: Tensor = NO_POINTS
    """(k, 3) the source's landmarks, world units; none is fine."""
    target_points: Tensor = NO_POINTS
    """(k, 3) where they are on the target."""
    landmark_names: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Both names."""
        return f"{self.source_name} → {self.target_name}"

    def bounds(self) -> Bounds:
        """The sphere round both splats, floaters left out."""
        return bounds(self.morph.source, self.end)

    @property
    def end(self) -> Gaussians:
        """The target where the morph ends: in its own place, or in the source's."""
        return self.morph.aligned if self.morph.stay else self.morph.target

    def side(self, part: str, t: float) -> Gaussians:
        """The ``"source"`` or the ``"target"`` alone at t, carried along at full opacity."""
        carried = self.morph.half(int(part == "target"), t)
        return carried if self.morph.stay else carried.moved(self.morph.frame.power(t))

    @torch.no_grad()
    def marks(self, t: float) -> tuple[Tensor, Tensor]:
        """The source's and the target's landmarks (k, 3) at t, world units."""
        flow, frame = self.morph.flow, self.morph.frame
        away = frame.inverse()
        place = Similarity.identity() if self.morph.stay else frame.power(t)
        source, target = flow(self.source_points, t), flow(away(self.target_points), t - 1)
        return place(source), place(target)


def open_subject(folder: str | Path, **options: Any) -> tuple[Subject, Mapping[str, Any]]:
    """The subject of a run directory, and the report of its fit; ``options`` are ``Morph``'s.

    The target is shown in the source's place.

    Raises:
        RunError: the directory is no run, or its inputs have moved or changed.
        OptionError: an unknown ramp or covariance, or a run of more than two splats.
    """
    run = open_run(folder)
    if len(run.inputs) != 2:
        raise OptionError(f"{folder} morphs {len(run.inputs)} splats, expected a run of two")
    (source, target), leg = run.load_inputs(), run.legs[0]
    options |= {"frame": leg.frame, "landmarks": leg.source_points}
    morph = Morph(source.gaussians, target.gaussians, leg.flow, **options)
    subject = Subject(
        replace(morph, target=morph.aligned, frame=Similarity.identity()),
        source.name,
        target.name,
        leg.source_points,
        leg.aligned_points,
        leg.names,
    )
    return subject, leg.report


def footprints(gaussians: Gaussians) -> Tensor:
    """(n,) how much of a picture each splat can cover: opacity × its two largest scales."""
    scales = gaussians.scales.sort(dim=1).values
    return gaussians.opacities * scales[:, 1] * scales[:, 2]


def thin(gaussians: Gaussians, most: int) -> Tensor:
    """Indices, ascending, of at most ``most`` splats: the visible ones that cover most."""
    visible = (gaussians.opacities >= FAINTEST_DRAWN).nonzero().flatten()
    if len(visible) <= most:
        return visible
    order = footprints(gaussians)[visible].argsort(descending=True, stable=True)
    return visible[order[:most]].sort().values
