"""Drive: a morph of two rigged heads that talk while the one turns into the other.

The flow knows one pose, the canonical one. A mesh between two persons of one topology is again a
person, so it can be posed by the model that poses both: at time t the meshes V⁰ and V¹ of the
heads, carried by the flow Φ, blend into

    V(t) = (1 - t) Φ(V⁰, t) + t Φ(V¹, t - 1),

which FLAME brings into any pose. Each splat of the morph keeps its place on its triangle.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from splatmorph.avatars.avatar import Avatar
from splatmorph.avatars.flame import Flame, Pose
from splatmorph.avatars.track import Track
from splatmorph.avatars.triangles import triangle_frames
from splatmorph.errors import OptionError
from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.similarity import Similarity
from splatmorph.morph import Morph
from splatmorph.morph.agreement import OnStep
from splatmorph.morph.ramps import EASES

FACE = "flame_face"
"""The extra under which a splat carries the number of its face through the morph."""


class Drive:
    """The morph of two avatars, posed frame by frame as a track says.

    The expression, jaw, neck and eyes come from the track; who speaks comes from the avatars, so
    the track's own shape and offsets are left aside.

    Arguments:
        source, target: avatars in the canonical pose.
        flow: Φ, fitted on them in that pose.
        track: what moves them; see ``Track.read``.
        whole_head: also take the rotation and translation of the whole head. They are left out
            otherwise, for the heads to stay before the camera and their shading to stay right.
        frame, stay: where the target stands, and whether to keep all in the source's place.
        options: those of ``Morph`` (ramp, covariance, ease, …).

    Raises:
        OptionError: an avatar that is in another pose or is only a mesh.
    """

    def __init__(
        self,
        source: Avatar,
        target: Avatar,
        flow: Flow,
        track: Track,
        *,
        whole_head: bool = False,
        ease: str = "linear",
        frame: Similarity | None = None,
        stay: bool = False,
        **options: Any,
    ) -> None:
        for avatar in (source, target):
            if not avatar.is_canonical:
                raise OptionError(
                    f"{avatar.name} was fitted in another pose ({avatar.posed}), but a track "
                    "drives heads from the canonical one: fit again without `frame`, `pose_from` "
                    "and `mesh`"
                )
        self.track = track
        self.flow = flow
        options |= {"frame": frame or Similarity.identity(), "stay": stay, "ease": ease}
        self._whole_head = whole_head
        self._flame, self._rests = _common_heads(source, target)
        self._morph = Morph(_marked(source), _marked(target), flow, **options)
        self._ease = EASES[ease]

    def frames(self, count: int) -> list[int]:
        """The track's frames for ``count`` pictures: evenly through it, the nearest ones."""
        return torch.linspace(0, len(self.track) - 1, count).round().long().tolist()

    def prepare(self, times: Sequence[float], on_step: OnStep | None = None) -> None:
        """As ``Morph.prepare``."""
        self._morph.prepare(times, on_step)

    def sequence(
        self, times: Sequence[float], frames: Sequence[int] | None = None
    ) -> Iterator[Gaussians]:
        """The morph at each time, posed as in the frame of the same place, one after the other.

        Arguments:
            times: any, as for ``Morph.sequence``.
            frames: as many frame numbers of the track; ``frames(len(times))`` if not given.

        Raises:
            OptionError: counts differ, no such frame, or a time that is no number.
        """
        frames = self.frames(len(times)) if frames is None else frames
        if len(frames) != len(times):
            raise OptionError(f"{len(frames)} frames for {len(times)} times, expected as many")
        poses = [self._pose(frame) for frame in frames]
        morphs = self._morph.sequence(times)
        return map(self._posed, morphs, self._meshes(times), poses)

    def _posed(self, morph: Gaussians, mesh: Tensor, pose: Pose) -> Gaussians:
        extras = dict(morph.extras)
        binding = extras.pop(FACE)
        with torch.no_grad():
            posed = self._flame(mesh, pose)
        faces = self._flame.faces
        away = triangle_frames(posed, faces).after(triangle_frames(mesh, faces).inverse())
        return away.apply(replace(morph, extras=extras), binding)

    def _meshes(self, times: Sequence[float]) -> Tensor:
        """(T, V, 3) the blended canonical mesh at each time."""
        eased = [self._ease(t) for t in times]
        first, second = self._rests
        with torch.no_grad():
            # A head that has faded out stays at the other's end, as its splats do.
            source = self.flow.trajectory(first, [min(t, 1.0) for t in eased])
            aligned = self._morph.frame.inverse()(second)
            target = self.flow.trajectory(aligned, [max(t - 1, -1.0) for t in eased])
        weight = torch.tensor(eased, dtype=source.dtype).clamp(0, 1)[:, None, None]
        meshes = (1 - weight) * source + weight * target
        if self._morph.stay:
            return meshes
        return torch.stack(
            [self._morph.frame.power(t)(mesh) for t, mesh in zip(eased, meshes, strict=True)]
        )

    def _pose(self, frame: int) -> Pose:
        pose = replace(self.track.pose(frame), offset=None)
        if self._whole_head:
            return pose
        joints = pose.joints.clone()
        joints[0] = 0
        return replace(pose, joints=joints, translation=torch.zeros_like(pose.translation))


def _marked(avatar: Avatar) -> Gaussians:
    extras = {**avatar.gaussians.extras, FACE: avatar.rig.binding}
    return replace(avatar.gaussians, extras=extras)


def _common_heads(source: Avatar, target: Avatar) -> tuple[Flame, tuple[Tensor, Tensor]]:
    """One model for both, with teeth if either has them, and the two persons on it."""
    persons = []
    for avatar in (source, target):
        assert avatar.rig.flame is not None
        assert avatar.rig.track is not None
        persons.append((avatar.rig.flame, avatar.rig.track))
    model = max((flame for flame, _ in persons), key=lambda flame: len(flame.template))
    first, second = (model.rest(track.shape, track.static_offset) for _, track in persons)
    return model, (first, second)
