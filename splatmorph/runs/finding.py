"""Landmarks for a fit that brings none: found, or added to the few that are given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splatmorph.landmarks import Landmarks
from splatmorph.registration import Found, find_landmarks, refine_landmarks
from splatmorph.registration.masks import without_masked
from splatmorph.registration.search import COUNT, Box, OnStep
from splatmorph.runs.inputs import Input


@dataclass(frozen=True)
class Finding:
    """Whether and how landmarks are looked for."""

    auto: bool = True
    """Look for landmarks where none are given."""
    refine: bool = False
    """Add landmarks on the surfaces to those that are given: for few (6 to 12) of them."""
    method: str = "auto"
    """auto (faces where both have one, then surfaces), face or surface."""
    count: int = COUNT
    """Landmarks on the surfaces."""
    face_model: Path | None = None
    """The file face_landmarker.task."""
    crop: Box | None = None
    """Only this box of the source is looked at, two corners; the target's too …"""
    target_crop: Box | None = None
    """… unless it has its own."""
    seed: int = 0

    def find(
        self,
        source: Input,
        target: Input,
        on_step: OnStep | None = None,
        on_warning: Callable[[str], None] | None = None,
    ) -> Found | None:
        """What a search adds to the inputs' own landmarks; None where they are all there is to be.

        Raises:
            SplatmorphError: the search is at fault; see :func:`find_landmarks`.
        """
        given = source.landmarks, target.landmarks
        shared: dict[str, Any] = {
            "count": self.count,
            "crop": self.crop,
            "target_crop": self.target_crop,
            "seed": self.seed,
            "on_step": on_step,
        }
        a, b = (without_masked(one.gaussians, one.path) for one in (source, target))
        if given[0] is not None and given[1] is not None:
            if not self.refine:
                return None
            pair: tuple[Landmarks, Landmarks] = given[0], given[1]
            found = refine_landmarks(a, b, pair, **shared)
        elif not self.auto:
            return None
        else:
            for one, other in ((source, target), (target, source)):
                if one.landmarks is not None and on_warning is not None:
                    on_warning(
                        f"{one.name} has landmarks and {other.name} has none: both are looked for"
                    )
            found = find_landmarks(a, b, self.method, face_model=self.face_model, **shared)
        if on_warning is not None:
            for warning in found.warnings:
                on_warning(warning)
        return found
