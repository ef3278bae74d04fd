"""Whether two avatars are posed alike, as a flow needs them."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from splatmorph.avatars.avatar import Avatar
from splatmorph.avatars.flame import Pose
from splatmorph.avatars.teeth import LOWER_LIP, UPPER_LIP
from splatmorph.geometry.quaternions import matrices_from_axis_angles

JOINTS_WATCHED = {"head": (0, 10.0), "neck": (1, 10.0), "jaw": (2, 3.0)}
"""Joint, and the angle in degrees from which two heads count as posed apart. The chin is some
8 cm from the jaw's axis: 3° move it by 4 mm, half the height of a lip."""
EXPRESSION_APART = 1.0
"""Distance of two expressions in FLAME's coefficients, whose unit is one standard deviation."""
LIPS_APART = 0.004
"""Metres by which the heights of two mouths may differ where only meshes are known."""


def pose_warnings(
    source: Avatar | None, target: Avatar | None, *, by_mesh: bool = True
) -> tuple[str, ...]:
    """What will look wrong in a morph of these two, one line each; empty if nothing will.

    Arguments:
        source, target: None stands for a plain splat, whose pose nobody knows.
        by_mesh: whether the landmarks are those of the meshes.
    """
    if source is None or target is None:
        posed = source or target
        return () if posed is None else (_half_known(posed),)
    warnings = []
    apart = _apart(source, target)
    if apart:
        warnings.append(
            f"{source.name} and {target.name} are posed apart ({', '.join(apart)}): a flow moves "
            "points but can't open a mouth, so lips will smear; pose both canonically (the "
            "default), or by one frame (`frame` with `pose_from`)"
        )
    same = source.vertices.shape == target.vertices.shape
    if by_mesh and same and torch.equal(source.vertices, target.vertices):
        warnings.append(
            f"the meshes of {source.name} and {target.name} are one and the same, so their "
            "landmarks coincide and nothing would move: give landmarks of your own, or the meshes "
            "that follow the two heads"
        )
    return tuple(warnings)


def _half_known(posed: Avatar) -> str:
    return (
        f"{posed.name} is a rigged avatar, posed {posed.posed}, and the other a plain splat in a "
        "pose of its own: a flow can't open a mouth, so check that both look alike, and pose "
        f"{posed.name} by `frame` if they don't"
    )


def _apart(source: Avatar, target: Avatar) -> list[str]:
    if source.pose is None or target.pose is None:
        difference = abs(_mouth_height(source.vertices) - _mouth_height(target.vertices))
        if difference <= LIPS_APART:
            return []
        return [f"mouths by {difference * 1000:.0f} mm"]
    angles = _angles(source.pose, target.pose)
    apart = [
        f"{name} by {angles[joint]:.0f}°"
        for name, (joint, most) in JOINTS_WATCHED.items()
        if angles[joint] > most
    ]
    expression = _expression_distance(source.pose.expression, target.pose.expression)
    if expression > EXPRESSION_APART:
        apart.append(f"expression by {expression:.1f} standard deviations")
    return apart


def _angles(source: Pose, target: Pose) -> list[float]:
    """Degrees between the rotations of each joint."""
    turned, turning = (matrices_from_axis_angles(each.joints) for each in (source, target))
    relative = turned.mT @ turning
    cosines = (relative.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    return [math.degrees(angle) for angle in cosines.clamp(-1, 1).acos().tolist()]


def _expression_distance(source: Tensor, target: Tensor) -> float:
    width = max(len(source), len(target))
    padded = [torch.cat([each, each.new_zeros(width - len(each))]) for each in (source, target)]
    return float((padded[0] - padded[1]).norm())


def _mouth_height(vertices: Tensor) -> float:
    """Mean distance of the lips' outer rings, which an open jaw parts."""
    return float((vertices[UPPER_LIP] - vertices[LOWER_LIP]).norm(dim=1).mean())
