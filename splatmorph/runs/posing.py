"""How the inputs of a fit are loaded: avatars posed alike, landmarks given, found and thinned."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path

from splatmorph.avatars import pose_warnings, thin
from splatmorph.errors import LandmarkError
from splatmorph.landmarks import Landmarks
from splatmorph.runs.inputs import Input, load_input
from splatmorph.runs.settings import Posing

Pair = tuple[Landmarks, Landmarks]


def load_inputs(
    paths: Sequence[str | Path], posing: Posing, on_warning: Callable[[str], None]
) -> tuple[Input, ...]:
    """Load the inputs of a fit in their order, and warn where they are posed apart.

    Raises:
        SplatmorphError: an input can't be read, or can't be posed so.
    """
    sides = [(posing.source_landmarks, posing.source_mesh)]
    sides.append((posing.target_landmarks, posing.target_mesh))
    sides += [(None, None)] * (len(paths) - 2)
    pose = {None: None, "source": paths[0], "target": paths[1]}[posing.pose_from]
    loaded = tuple(
        load_input(
            path,
            landmarks=landmarks,
            mesh=mesh,
            frame=posing.frame,
            pose=pose,
            landmarks_set=posing.landmarks_set,
            flame=posing.flame,
        )
        for path, (landmarks, mesh) in zip(paths, sides, strict=True)
    )
    by_mesh = not (posing.source_landmarks or posing.target_landmarks)
    for one, following in itertools.pairwise(loaded):
        for warning in pose_warnings(one.avatar, following.avatar, by_mesh=by_mesh):
            on_warning(warning)
    return loaded


def thinned(pair: Pair, posing: Posing) -> Pair:
    """The landmarks to fit: all that match, or as many as were asked for."""
    if posing.landmarks_count is not None:
        return thin(*pair, posing.landmarks_count)
    return thin(*pair) if posing.landmarks_set == "dense" else pair


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
