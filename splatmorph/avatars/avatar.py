"""Avatar: a rigged head in one pose, as splats with landmarks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from torch import Tensor

from splatmorph.avatars.flame import Pose
from splatmorph.avatars.landmark_sets import mesh_landmarks
from splatmorph.avatars.places import TRACK_NAME, find_avatar, find_embedding
from splatmorph.avatars.rig import Rig, read_rig
from splatmorph.avatars.track import Track
from splatmorph.errors import ReadError
from splatmorph.gaussians import Gaussians
from splatmorph.landmarks import Landmarks

CANONICAL = "canonical"


@dataclass(frozen=True)
class Avatar:
    """A rig in a pose."""

    rig: Rig
    gaussians: Gaussians
    """The splats in world space, metres."""
    vertices: Tensor
    """(V, 3) the mesh that carries them, float64."""
    landmarks: Landmarks
    pose: Pose | None
    """None where only a mesh file is known."""
    posed: str
    """In words: canonical, frame N of a track, as its mesh."""
    files: tuple[Path, ...]
    """What was read for it, FLAME itself apart."""
    options: Mapping[str, str | int]
    """What to give ``load_avatar`` to have it again; JSON-able, paths absolute."""

    @property
    def name(self) -> str:
        """What people call it: the folder that they keep it in."""
        return self.rig.places.name

    @property
    def is_canonical(self) -> bool:
        """Whether it is in the pose that can be driven from."""
        return self.posed == CANONICAL


def load_avatar(
    path: str | Path,
    *,
    frame: int | None = None,
    pose: str | Path | None = None,
    landmarks_set: str = "254",
    flame: str | Path | None = None,
    mesh: str | Path | None = None,
) -> Avatar:
    """Load an avatar of GaussianAvatars into world space.

    Arguments:
        path: its splat file, the directory of that, or the model directory.
        frame: pose it as in this frame of its own track, or of that of ``pose``; without one the
            pose is canonical: no expression, mouth closed, head straight.
        pose: another avatar, or a ``flame_param.npz``, whose track gives the pose (frame 0 if no
            ``frame`` is given), so that two avatars are posed alike.
        landmarks_set: ``70``, ``254`` or ``dense``; see ``mesh_landmarks``.
        flame: the FLAME model file or its folder.
        mesh: the head's vertices, in place of FLAME parameters.

    Raises:
        ReadError: a file is missing or wrong; the line says which and what to do.
        OptionError: no such frame or landmark set, or a pose for a head that is only a mesh.
    """
    rig = read_rig(path, flame=flame, mesh=mesh)
    chosen, posed, files = _choose_pose(rig, frame, pose)
    vertices = rig.rest if chosen is None else rig.posed(chosen)
    # FLAME's y is up; a track may turn the whole head.
    gaussians = replace(rig.bake(vertices), up="y" if posed == CANONICAL else None)
    near = rig.places.splats
    embedding = find_embedding(flame, near=near) if landmarks_set == "70" else None
    landmarks = mesh_landmarks(landmarks_set, vertices, rig.faces, gaussians, embedding)
    options: dict[str, str | int] = {"landmarks_set": landmarks_set}
    if frame is not None:
        options["frame"] = frame
    for name, given in (("pose", pose), ("flame", flame), ("mesh", mesh)):
        if given is not None:
            options[name] = str(Path(given).expanduser().resolve())
    return Avatar(rig, gaussians, vertices, landmarks, chosen, posed, (near, *files), options)


def baked(rig: Rig, track: Track) -> Iterator[Gaussians]:
    """The avatar in every frame of ``track``, its own or another's, one after the other.

    Raises:
        OptionError: the avatar is only a mesh, which can't be posed.
    """
    for frame in range(len(track)):
        yield rig.bake(rig.posed(_pose_of(rig, track, frame)))


def track_of(path: str | Path) -> Track:
    """The track of an avatar, or of a ``.npz`` itself.

    Raises:
        ReadError: there is none, or it is damaged.
    """
    path = Path(path)
    if path.suffix.lower() == ".npz":
        return Track.read(path)
    found = find_avatar(path).track
    if found is None:
        raise ReadError(f"{path} has no {TRACK_NAME}, so it has no pose to give: name another")
    return Track.read(found)


def _choose_pose(
    rig: Rig, frame: int | None, pose: str | Path | None
) -> tuple[Pose | None, str, tuple[Path, ...]]:
    """The pose, its name, and the files that it was read from."""
    canonical = frame is None and pose is None
    if rig.track is None:
        mesh = [file for file in (rig.places.mesh, rig.places.faces) if file is not None]
        # A head that is only a mesh refuses any frame by itself.
        return None if canonical else Pose.canonical(), "as its mesh", tuple(mesh)
    if canonical:
        return Pose.canonical(), CANONICAL, (rig.track.path,)
    number = frame or 0
    track = rig.track if pose is None else track_of(pose)
    if _is_own(rig, track):
        return track.pose(number), f"frame {number} of its track", (track.path,)
    posed = f"frame {number} of {track.path}"
    return _pose_of(rig, track, number), posed, (rig.track.path, track.path)


def _pose_of(rig: Rig, track: Track, frame: int) -> Pose:
    pose = track.pose(frame)
    # The offsets of another person's vertices would make this one another person.
    return pose if _is_own(rig, track) else replace(pose, offset=None)


def _is_own(rig: Rig, track: Track) -> bool:
    return rig.track is not None and track.path.resolve() == rig.track.path.resolve()
