"""Landmarks for a fit that brings none: found, or added to the few that are given."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from splatmorph.landmarks import Landmarks
from splatmorph.registration import Found, find_landmarks, refine_landmarks
from splatmorph.registration.masks import without_masked
from splatmorph.registration.search import OnStep
from splatmorph.runs.inputs import Input
from splatmorph.runs.settings import Finding


def find(
    finding: Finding,
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
    both = given[0] is not None and given[1] is not None
    if not (finding.refine if both else finding.auto):
        return None
    shared: dict[str, Any] = {
        "count": finding.count,
        "crop": finding.crop,
        "target_crop": finding.target_crop,
        "seed": finding.seed,
        "on_step": on_step,
    }
    a, b = (without_masked(one.gaussians, one.path) for one in (source, target))
    if given[0] is not None and given[1] is not None:
        pair: tuple[Landmarks, Landmarks] = given[0], given[1]
        found = refine_landmarks(a, b, pair, **shared)
    else:
        for one, other in ((source, target), (target, source)):
            if one.landmarks is not None and on_warning is not None:
                on_warning(
                    f"{one.name} has landmarks and {other.name} has none: both are looked for"
                )
        found = find_landmarks(a, b, finding.method, face_model=finding.face_model, **shared)
    if on_warning is not None:
        for warning in found.warnings:
            on_warning(warning)
    return found
