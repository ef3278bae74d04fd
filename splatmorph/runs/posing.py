"""How the inputs of a fit are loaded: avatars posed alike, landmarks given, found and thinned."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from splatmorph.avatars import pose_warnings, thin
from splatmorph.errors import LandmarkError, OptionError
from splatmorph.io.offsets import lost_detail
from splatmorph.landmarks import Landmarks
from splatmorph.runs.inputs import Input, load_input

Pair = tuple[Landmarks, Landmarks]


@dataclass(frozen=True)
class Posing:
    """Where landmarks come from and how avatars are posed; plain splats stay as they are."""

    source_landmarks: Path | None = None
    """Default: landmarks beside the source, or those of its FLAME mesh."""
    target_landmarks: Path | None = None
    """Default: landmarks beside the target, or those of its FLAME mesh."""
    landmarks_set: str = "254"
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

    def load(
        self, paths: Sequence[str | Path], on_warning: Callable[[str], None]
    ) -> tuple[Input, ...]:
        """Load the inputs in their order, and warn where they are posed apart.

        Raises:
            SplatmorphError: an input can't be read, or can't be posed so.
        """
        sides = [(self.source_landmarks, self.source_mesh)]
        sides.append((self.target_landmarks, self.target_mesh))
        sides += [(None, None)] * (len(paths) - 2)
        pose = {None: None, "source": paths[0], "target": paths[1]}[self.pose_from]
        loaded = tuple(
            load_input(
                path,
                landmarks=landmarks,
                mesh=mesh,
                frame=self.frame,
                pose=pose,
                landmarks_set=self.landmarks_set,
                flame=self.flame,
            )
            for path, (landmarks, mesh) in zip(paths, sides, strict=True)
        )
        for one in loaded:
            if (spacing := lost_detail(one.gaussians)) is not None:
                on_warning(
                    f"{one.path} holds its centers in single precision so far from the origin "
                    f"that they are rounded to {spacing:.2g}, more than its splats measure: "
                    "export it with doubles or nearer to the origin"
                )
        by_mesh = not (self.source_landmarks or self.target_landmarks)
        for one, following in itertools.pairwise(loaded):
            for warning in pose_warnings(one.avatar, following.avatar, by_mesh=by_mesh):
                on_warning(warning)
        return loaded

    def thinned(self, pair: Pair) -> Pair:
        """The landmarks to fit: all that match, or as many as were asked for."""
        if self.landmarks_count is not None:
            return thin(*pair, self.landmarks_count)
        return thin(*pair) if self.landmarks_set == "dense" else pair


def landmarks_of(loaded: Input) -> Landmarks:
    """The landmarks of an input.

    Raises:
        LandmarkError: it has none.
    """
    if loaded.landmarks is None:
        raise LandmarkError(
            f"{loaded.path} has no landmarks beside it: put them in "
            f'{loaded.name}.landmarks.json ({{"points": {{"nose": [x, y, z], …}}}}), or give '
            "`source_landmarks` and `target_landmarks`"
        )
    return loaded.landmarks
