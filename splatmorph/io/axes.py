"""Which way a splat's axes point: what files say of it, and how to turn one frame into another.

A frame is named by where its axes x, y and z point for who looks at the object's front: RUB is
x to the right, y up, z back to the viewer, which is the frame of glTF and the usual one of SPZ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from splatmorph.gaussians import UPS, Gaussians
from splatmorph.geometry.similarity import Similarity

VERTICAL = "vertical axis:"
"""The comment by which nerfstudio says so, and which Brush knows."""

DIRECTIONS = {
    "R": (1, 0, 0),
    "L": (-1, 0, 0),
    "U": (0, 1, 0),
    "D": (0, -1, 0),
    "B": (0, 0, 1),
    "F": (0, 0, -1),
}
"""In the frame RUB."""

USUAL = "RUB"
FRAMES: Mapping[str, str] = {
    "y": USUAL,
    "-y": "LDB",
    "z": "RFU",
    "-z": "RBD",
    "x": "ULB",
    "-x": "DRB",
}
"""The frame that an axis stands for where nothing is known but that it points up."""


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


def upright(gaussians: Gaussians, up: str) -> Gaussians:
    """The splats turned so that the axis ``up`` points up, from ``gaussians.up`` (y if unsaid)."""
    turn = _into_usual(FRAMES[up]).T @ _into_usual(FRAMES[gaussians.up or "y"])
    return replace(_turned(gaussians, turn), up=up)


def turn_between(up: str, other: str) -> Similarity:
    """The rotation that takes points of what stands on ``up`` to where ``other`` is up."""
    turn = _into_usual(FRAMES[other]).T @ _into_usual(FRAMES[up])
    return Similarity(turn, 1.0, torch.zeros(3))


def from_frame(gaussians: Gaussians, frame: str) -> Gaussians:
    """Splats whose axes point as ``frame`` says: where one of ``FRAMES`` does too, as they are.

    Others, and those of the wrong hand, are turned (and mirrored) into the usual frame.
    """
    for up, known in FRAMES.items():
        if known == frame:
            return replace(gaussians, up=up)
    return replace(_turned(gaussians, _into_usual(frame)), up="y")


def _turned(gaussians: Gaussians, turn: Tensor) -> Gaussians:
    if torch.linalg.det(turn) < 0:
        gaussians, turn = _inverted(gaussians), -turn
    similarity = Similarity(turn, 1.0, torch.zeros(3))
    x, y, z = similarity(torch.tensor(gaussians.offset, dtype=torch.float64)).tolist()
    return replace(gaussians.moved(similarity), offset=(x, y, z))


def _inverted(gaussians: Gaussians) -> Gaussians:
    """x ↦ -x: ellipsoids stay what they are, and harmonics of odd degree change their sign."""
    sign = torch.cat([torch.full((2 * band + 1,), (-1.0) ** band) for band in range(5)])
    sh = gaussians.sh * sign[: gaussians.sh.shape[1], None].to(gaussians.sh)
    x, y, z = gaussians.offset
    return replace(gaussians, means=-gaussians.means, sh=sh, offset=(-x, -y, -z))


def _into_usual(frame: str) -> Tensor:
    """(3, 3) float64: points of ``frame`` as those of RUB."""
    return torch.tensor([DIRECTIONS[letter] for letter in frame], dtype=torch.float64).T
