"""What a fit is asked for, in plain values: loaded without torch, to be shown and parsed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from splatmorph.errors import OptionError

Box = tuple[float, ...]


Method = Literal["auto", "face", "surface"]
"""How landmarks are looked for."""


@dataclass(frozen=True)
class Fitting:
    """Which flow, and how it is fitted."""

    flow: str = "node"
    """node or ncf; or a baseline: ifmorph, tps, linear."""
    field: Literal["spline", "siren"] | None = None
    """Of the node flow: spline (the default) or siren."""
    smoothing: float | None = None
    """Weight of bending against missed landmarks, 0 meets them; chosen by the landmarks if not
    given."""
    energy: Literal["jacobian", "hessian"] | None = None
    """What training keeps small: jacobian (the paper's) or hessian."""
    steps: int | None = None
    """Most training steps."""
    seed: int = 0
    """Seed of everything random."""


@dataclass(frozen=True)
class Posing:
    """Where landmarks come from and how avatars are posed; plain splats stay as they are."""

    source_landmarks: Path | None = None
    """Default: landmarks beside the source, or those of its FLAME mesh."""
    target_landmarks: Path | None = None
    """Default: landmarks beside the target, or those of its FLAME mesh."""
    landmarks_set: Literal["70", "254", "dense"] = "254"
    """Of FLAME: 70, 254, dense."""
    landmarks_count: int | None = None
    """Use at most this many landmarks, spread evenly; 500 of the dense set by default."""
    frame: int | None = None
    """Pose avatars as in this frame of their tracks; canonical if not given."""
    pose_from: Literal["source", "target"] | None = None
    """Take the pose of all from this one's track, so that mouths agree."""
    flame: Path | None = None
    """The FLAME model file or its folder; else the variable SPLATMORPH_FLAME."""
    source_mesh: Path | None = None
    """The source's FLAME mesh, in place of flame_param.npz."""
    target_mesh: Path | None = None
    """The target's FLAME mesh, in place of flame_param.npz."""

    def __post_init__(self) -> None:
        if self.pose_from not in (None, "source", "target"):
            raise OptionError(f"pose_from is {self.pose_from!r}, expected source or target")


@dataclass(frozen=True)
class Finding:
    """Whether and how landmarks are looked for."""

    auto: bool = True
    """Look for landmarks where none are given."""
    refine: bool = False
    """Add landmarks on the surfaces to those that are given: for few (6 to 12) of them."""
    method: Method = "auto"
    """auto (faces where both have one, then surfaces), face or surface."""
    count: int = 400
    """Landmarks on the surfaces."""
    face_model: Path | None = None
    """The file face_landmarker.task."""
    crop: Box | None = None
    """Only this box of the source is looked at, two corners; the target's too …"""
    target_crop: Box | None = None
    """… unless it has its own."""
    seed: int = 0


DEFAULT_FITTING, DEFAULT_POSING, DEFAULT_FINDING = Fitting(), Posing(), Finding()
