"""How the inputs of a fit are loaded: avatars posed alike, landmarks thinned, mismatches told."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.avatars import LANDMARK_SETS, pose_warnings, thin
from splatmorph.errors import LandmarkError
from splatmorph.landmarks import Landmarks
from splatmorph.runs.inputs import Input, load_input

Pair = tuple[Landmarks, Landmarks]


@Parameter(name="*")
@dataclass(frozen=True)
class Posing:
    """Where landmarks come from and how avatars are posed; plain splats stay as they are."""

    source_landmarks: Path | None = None
    """Default: landmarks beside the source, or those of its FLAME mesh."""
    target_landmarks: Path | None = None
    """Default: landmarks beside the target, or those of its FLAME mesh."""
    landmarks_set: Annotated[str, Parameter(help=f"Of FLAME: {', '.join(LANDMARK_SETS)}.")] = "254"
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

    def load(self, paths: Sequence[Path]) -> list[Input]:
        """Load the inputs in their order, and warn where they are posed apart."""
        sides = {0: (self.source_landmarks, self.source_mesh)}
        sides[1] = (self.target_landmarks, self.target_mesh)
        pose = {None: None, "source": paths[0], "target": paths[1]}[self.pose_from]
        loaded = []
        for i, path in enumerate(paths):
            landmarks, mesh = sides.get(i, (None, None))
            loaded.append(
                load_input(
                    path,
                    landmarks=landmarks,
                    mesh=mesh,
                    frame=self.frame,
                    pose=pose,
                    landmarks_set=self.landmarks_set,
                    flame=self.flame,
                )
            )
        for one, following in itertools.pairwise(loaded):
            if one.avatar or following.avatar:
                by_mesh = not (self.source_landmarks or self.target_landmarks)
                for warning in pose_warnings(one.avatar, following.avatar, by_mesh=by_mesh):
                    console.warn(warning)
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
            "--source-landmarks and --target-landmarks"
        )
    return loaded.landmarks
