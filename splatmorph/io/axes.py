"""Which axis of a splat points up, as the headers of PLY files say it."""

from __future__ import annotations

from collections.abc import Sequence

from splatmorph.gaussians import UPS, Gaussians

VERTICAL = "vertical axis:"
"""The comment by which nerfstudio says so, and which Brush knows."""


def vertical_axis(comments: Sequence[str]) -> str | None:
    """The axis that a header's comments say is up, one of ``UPS``; None if none does."""
    for line in comments:
        if line.lower().startswith(VERTICAL):
            axis = line[len(VERTICAL) :].strip().lower().removeprefix("+")
            return axis if axis in UPS else None
    return None


def vertical_comments(gaussians: Gaussians) -> list[str]:
    """The comment that says which axis of a splat is up; none where nothing said so before."""
    return [] if gaussians.up is None else [f"Vertical Axis: {gaussians.up}"]
