"""Landmarks for a fit that brings none: found, or added to the few that are given."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

import torch
from torch import Tensor

from splatmorph.landmarks import Landmarks
from splatmorph.registration import Found, find_landmarks, refine_landmarks
from splatmorph.registration.masks import Mask, without_masked
from splatmorph.registration.search import OnStep
from splatmorph.runs.inputs import Input, fingerprint
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


def described(finding: Finding, inputs: Sequence[Input]) -> dict[str, Any]:
    """What a search depends on beside its splats, in JSON's types."""
    values = asdict(finding) | {"face_model": finding.face_model and str(finding.face_model)}
    masks = [Mask.path_beside(one.path) for one in inputs]
    values["masks"] = [fingerprint((mask,)) if mask.is_file() else None for mask in masks]
    return {
        name: list(value) if isinstance(value, tuple) else value for name, value in values.items()
    }


def find_common(
    finding: Finding,
    inputs: Sequence[Input],
    on_step: OnStep | None = None,
    on_warning: Callable[[str], None] | None = None,
) -> list[Landmarks] | None:
    """Landmarks that all inputs share; None where each brings its own, or none are looked for.

    The first is searched against each of the others: what is seen on it is the same in every
    search, so that equal names with equal points on it denote one landmark.
    """
    if not finding.auto or all(one.landmarks is not None for one in inputs):
        return None
    bare = [replace(one, landmarks=None) for one in inputs]
    pairs = [
        _by_name(found)
        for other in bare[1:]
        if (found := find(finding, bare[0], other, on_step, on_warning)) is not None
    ]
    common = [
        name
        for name, (point, _) in pairs[0].items()
        if all(name in pair and torch.allclose(pair[name][0], point) for pair in pairs)
    ]
    sides = [
        [pairs[0][name][0] for name in common],
        *([pair[name][1] for name in common] for pair in pairs),
    ]
    return [Landmarks(torch.stack(points), tuple(common)) for points in sides]


def _by_name(found: Found) -> dict[str, tuple[Tensor, Tensor]]:
    """Name → (point on the source, point on the target)."""
    p, q, names = found.source.match(found.target)
    return {name: (a, b) for name, a, b in zip(names, p, q, strict=True)}
