"""Two splats in, landmarks on both out: faces where both have one, surfaces for the rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from splatmorph.errors import LandmarkError, MissingExtraError, OptionError, ReadError
from splatmorph.flows import Node
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.alignment import similarity_between
from splatmorph.geometry.spreading import farthest
from splatmorph.landmarks import FOUND, Landmarks
from splatmorph.registration import confidence
from splatmorph.registration.cleaning import without_floaters
from splatmorph.registration.face_network import find_model, load_network
from splatmorph.registration.faces import FoundFace, find_face
from splatmorph.registration.gaps import Gap, gap_between
from splatmorph.registration.matches import FACES, FREE, FROM_AFAR, HELD, Matched, Schedule, match
from splatmorph.registration.pose import find_poses
from splatmorph.registration.regression import Pairs, flow
from splatmorph.registration.subject import Subject, prepare
from splatmorph.steady import one_thread

METHODS = ("auto", "face", "surface")
COUNT = 400
"""Landmarks on the surfaces; those of a face come beside."""
FEWEST_FACE_POINTS = 50
OUT_STEPS = 8
"""Runge-Kutta steps a unit of t by which the landmarks are carried."""
ROOM = 0.06
"""Radii round a given landmark in which none is found: there it says all."""

Box = Sequence[float]
"""x0, y0, z0, x1, y1, z1: two corners."""
OnStep = Callable[[int, int, str], None]
"""(steps done, steps in all, what is being done)"""


@dataclass(frozen=True)
class Found:
    """Landmarks that a search found."""

    source: Landmarks
    target: Landmarks
    how: str
    """What they rest on, in words."""
    confidence: float
    """0 to 1, of the whole."""
    warnings: tuple[str, ...]
    """What may be wrong, one line each."""

    @property
    def doubtful(self) -> bool:
        """Whether somebody should look at them."""
        return self.confidence < confidence.FAIR or bool(self.warnings)

    def __str__(self) -> str:
        return (
            f"found {len(self.source)} landmarks by {self.how}: "
            f"{confidence.in_words(self.confidence)} ({self.confidence:.2f} of 1)"
        )


def correspond(
    source: Gaussians,
    target: Gaussians,
    method: str = "auto",
    *,
    count: int = COUNT,
    face_model: str | Path | None = None,
    seed: int = 0,
) -> tuple[Landmarks, Landmarks]:
    """Landmarks of two splats in any pose, matched by name; see :func:`find_landmarks`."""
    found = find_landmarks(source, target, method, count=count, face_model=face_model, seed=seed)
    return found.source, found.target


@one_thread()
def find_landmarks(
    source: Gaussians,
    target: Gaussians,
    method: str = "auto",
    *,
    count: int = COUNT,
    face_model: str | Path | None = None,
    crop: Box | None = None,
    target_crop: Box | None = None,
    seed: int = 0,
    on_step: OnStep | None = None,
) -> Found:
    """Find landmarks on two splats, each set in its own splat's coordinates.

    Args:
        source, target: in any pose, scale and order of splats.
        method: "auto" takes faces where both have one, then surfaces for the rest; "face" the
            points of the faces alone; "surface" never looks for faces.
        count: landmarks on the surfaces, half of them spread over either side.
        face_model: the file ``face_landmarker.task``; see :func:`find_model`.
        crop: only what lies in this box of the source is looked at, x0, y0, z0, x1, y1, z1;
            the target's too, unless ``target_crop`` says otherwise.
        seed: of the choice of samples.
        on_step: called with the progress.

    Raises:
        OptionError: an unknown method, a count below 8, a box with nothing in it.
        LandmarkError: nothing is to be seen, or no face where one is asked for.
        ReadError, MissingExtraError: faces are asked for, and the model or OpenCV is not there.
    """
    if method not in METHODS:
        raise OptionError(f"method is {method!r}, expected one of {', '.join(METHODS)}")
    search = _Search(source, target, crop, target_crop, count, seed, on_step)
    faces, warnings = None, []
    if method != "surface":
        try:
            faces = search.faces(face_model)
        except (ReadError, MissingExtraError) as error:
            if method == "face":
                raise
            warnings.append(f"no faces were looked for: {error}")
    if method == "face":
        if faces is None:
            raise LandmarkError(
                f"{search.faceless}, expected the same side of one on each: give landmarks, or "
                "take the method 'surface'"
            )
        return Found(*search.of_faces(faces), "faces", float(faces.confidence.mean()), ())
    if faces is None:
        return search.by_surfaces(warnings)
    return search.by_faces(faces, warnings)


@one_thread()
def refine_landmarks(
    source: Gaussians,
    target: Gaussians,
    landmarks: tuple[Landmarks, Landmarks],
    *,
    count: int = COUNT,
    crop: Box | None = None,
    target_crop: Box | None = None,
    seed: int = 0,
    on_step: OnStep | None = None,
) -> Found:
    """Add landmarks on the surfaces to given ones, which stay as they are.

    Recommended for few (6 to 12); many good ones lose some of their own precision between them.
    Arguments and errors as those of :func:`find_landmarks`.
    """
    p, q, names = landmarks[0].match(landmarks[1])
    search = _Search(source, target, crop, target_crop, count, seed, on_step)
    return search.by_landmarks(p, q, names)


@dataclass(frozen=True)
class _FacePairs:
    """Points that both faces have, in world units."""

    p: Tensor
    """(k, 3) float64"""
    q: Tensor
    names: tuple[str, ...]
    confidence: Tensor

    @staticmethod
    def of(source: FoundFace, target: FoundFace) -> _FacePairs | None:
        sure = torch.from_numpy(np.minimum(source.confidence, target.confidence))
        kept = sure > 0
        if int(kept.sum()) < FEWEST_FACE_POINTS:
            return None
        p, q = (torch.from_numpy(face.points)[kept] for face in (source, target))
        names = tuple(f"face_{i}" for i in kept.nonzero().flatten().tolist())
        return _FacePairs(p, q, names, sure[kept])


class _Search:
    """One search: the cleaned splats, and how far it is."""

    def __init__(
        self,
        source: Gaussians,
        target: Gaussians,
        crop: Box | None,
        target_crop: Box | None,
        count: int,
        seed: int,
        on_step: OnStep | None,
    ) -> None:
        if count < 8:
            raise OptionError(f"count is {count}, expected at least 8 landmarks")
        boxes = crop, crop if target_crop is None else target_crop
        self.splats = tuple(
            without_floaters(_inside(splat, box, name))
            for splat, box, name in zip((source, target), boxes, ("source", "target"), strict=True)
        )
        self.count, self.seed, self.on_step = count, seed, on_step
        self.done, self.steps = 0, 2 + 2 + 1 + len(FREE.sigmas)
        self.faceless = ""
        """Why there are no pairs of faces, in words."""

    def _step(self, what: str) -> None:
        if self.on_step is not None:
            self.on_step(self.done, self.steps, what)
        self.done += 1

    def faces(self, model: str | Path | None) -> _FacePairs | None:
        """The points that the faces of both have, if both have one."""
        network = load_network(find_model(model))
        found = []
        for splat, name in zip(self.splats, ("source", "target"), strict=True):
            self._step(f"looking for a face on the {name}")
            found.append(find_face(splat, network))
        source, target = found
        if source is not None and target is not None:
            self.faceless = "the two faces show next to nothing in common"
            return _FacePairs.of(source, target)
        without = [name for name, face in (("source", source), ("target", target)) if face is None]
        self.faceless = f"no face is found on the {' and on the '.join(without)}"
        return None

    def of_faces(self, faces: _FacePairs) -> tuple[Landmarks, Landmarks]:
        """The faces' own points."""
        return (
            Landmarks(faces.p, faces.names, faces.confidence),
            Landmarks(faces.q, faces.names, faces.confidence),
        )

    def by_faces(self, faces: _FacePairs, warnings: list[str]) -> Found:
        """Faces give the pose and hold the flow; surfaces find the rest."""
        flowing = self._held(faces.p, faces.q, FACES)
        whole = confidence.of_faces(faces.confidence, flowing.gap)
        p = flowing.source.to_unit(faces.p).float()
        carried = flowing.to_world(1, flow(flowing.node, p, 1.0))
        return self._found(
            (faces.p, carried, faces.names, faces.confidence),
            flowing.landmarks(self.count, whole),
            "faces and surfaces",
            whole,
            warnings,
        )

    def by_landmarks(self, p: Tensor, q: Tensor, names: tuple[str, ...]) -> Found:
        """Given landmarks hold the flow."""
        flowing = self._held(p, q, HELD)
        sure = torch.ones(len(p), dtype=torch.float64)
        whole = confidence.of_faces(sure, flowing.gap)
        surface = flowing.landmarks(self.count, whole)
        room = ROOM / flowing.source.to_unit.scale
        kept = torch.cdist(surface[0], p).amin(1) > room
        return self._found(
            (p, q, names, sure),
            tuple(column[kept] for column in surface),
            "the given landmarks and surfaces",
            whole,
            [],
        )

    def by_surfaces(self, warnings: list[str]) -> Found:
        """Shape and looks alone."""
        source, target = self._subjects()
        as_is = target.to_unit @ source.to_unit.inverse()
        self._step("searching the pose")
        poses = find_poses(source, target, as_is)
        best = poses[0].similarity
        schedule = FREE if best is as_is else FROM_AFAR
        self.steps += schedule.wide + len(schedule.sigmas) - len(FREE.sigmas)
        flowing = self._flowing(source.posed(best), target, schedule, None)
        sure, doubts = confidence.of_surfaces(poses, flowing.matched.distinct, flowing.gap)
        nothing = torch.zeros(0, 3, dtype=torch.float64)
        return self._found(
            (nothing, nothing, (), nothing[:, 0]),
            flowing.landmarks(self.count, sure),
            "surfaces",
            sure,
            [*warnings, *doubts],
        )

    def _held(self, p: Tensor, q: Tensor, schedule: Schedule) -> _Flowing:
        source, target = self._subjects()
        unit_p, unit_q = source.to_unit(p), target.to_unit(q)
        pose = similarity_between(unit_p, unit_q)
        held = Pairs(pose(unit_p).float(), unit_q.float(), torch.ones(len(p)))
        return self._flowing(source.posed(pose), target, schedule, held)

    def _subjects(self) -> tuple[Subject, Subject]:
        made = []
        for splat, name in zip(self.splats, ("source", "target"), strict=True):
            self._step(f"seeing the surface of the {name}")
            made.append(prepare(splat, seed=self.seed))
        return made[0], made[1]

    def _flowing(
        self, source: Subject, target: Subject, schedule: Schedule, held: Pairs | None
    ) -> _Flowing:
        found = match(source, target, schedule, held, lambda: self._step("matching the surfaces"))
        found.node.steps = OUT_STEPS
        return _Flowing(source, target, found)

    def _found(
        self,
        given: tuple[Tensor, Tensor, tuple[str, ...], Tensor],
        surface: tuple[Tensor, ...],
        how: str,
        sure: float,
        warnings: list[str],
    ) -> Found:
        p, q, names, own = given
        more, there, local = surface
        names = (*names, *(f"{FOUND}{i:04d}" for i in range(1, len(more) + 1)))
        each = torch.cat([own, local])
        return Found(
            Landmarks(torch.cat([p, more]), names, each),
            Landmarks(torch.cat([q, there]), names, each),
            how,
            sure,
            tuple(warnings),
        )


@dataclass(frozen=True)
class _Flowing:
    """Two sides in the target's unit coordinates, and the flow between them."""

    source: Subject
    target: Subject
    matched: Matched

    @property
    def node(self) -> Node:
        """The flow."""
        return self.matched.node

    @property
    def gap(self) -> Gap:
        """How far apart the surfaces are at half-time."""
        return gap_between(
            flow(self.node, torch.from_numpy(self.source.dense.points), 0.5),
            flow(self.node, torch.from_numpy(self.target.dense.points), -0.5),
            1.0,
        )

    def to_world(self, side: int, points: Tensor) -> Tensor:
        """Unit points in the coordinates of one side's splat."""
        subject = (self.source, self.target)[side]
        return subject.to_unit.inverse()(points.double())

    def landmarks(self, count: int, whole: float) -> tuple[Tensor, Tensor, Tensor]:
        """Pairs (m, 3) that the flow takes into each other, evenly over both, and how sure, by
        the confidence of the ``whole``."""
        ends: list[tuple[Tensor, Tensor]] = []
        sure = []
        for subject, partners, t in zip(
            (self.source, self.target), self.matched.partners, (1.0, -1.0), strict=True
        ):
            chosen = torch.from_numpy(farthest(subject.samples.points, count // 2, first=0))
            own = torch.from_numpy(subject.samples.points)
            there = flow(self.node, own[chosen], t).double()
            ends.append((own[chosen], there) if t > 0 else (there, own[chosen]))
            sure.append(confidence.of_points(own, partners, whole)[chosen])
        p, q = (torch.cat(column) for column in zip(*ends, strict=True))
        return self.to_world(0, p), self.to_world(1, q), torch.cat(sure)


def _inside(splat: Gaussians, box: Box | None, name: str) -> Gaussians:
    """The splats whose centers lie in a box."""
    if box is None:
        return splat
    corners = torch.tensor(box, dtype=splat.means.dtype).reshape(2, 3)
    low, high = corners.amin(0), corners.amax(0)
    inside = ((splat.means >= low) & (splat.means <= high)).all(1)
    if not inside.any():
        shown = ",".join(f"{value:g}" for value in box)
        raise OptionError(f"no splat of the {name} lies in the box {shown}: give another `crop`")
    return splat.select(inside)
