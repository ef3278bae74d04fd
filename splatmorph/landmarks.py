"""Landmarks: named points on an object, and how two sets of them correspond."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from splatmorph.errors import LandmarkError, OptionError, ReadError
from splatmorph.geometry.alignment import similarity_between
from splatmorph.geometry.similarity import Similarity
from splatmorph.io import stem_of
from splatmorph.io.atomic import atomic_write
from splatmorph.io.reading import reading
from splatmorph.landmark_files import MARKUPS, READERS, given_twice, parsed

FEWEST = {2: 3, 3: 4}
"""Matched pairs below which an affine map of the plane, of space, is not determined."""
FOUND = "auto_"
"""Names of landmarks that a search found on two surfaces begin so; a number follows."""


@dataclass(frozen=True)
class Landmarks:
    """Points on one object, matched to another's by name, or by order where they have no names.

    Raises:
        LandmarkError: a name or a point that is not finite, a name given twice.
    """

    points: Tensor
    """(k, dim) float64, world units (pixels for images)."""
    names: tuple[str, ...] | None = None
    """k names, or None: matched by order."""
    confidence: Tensor | None = None
    """(k,) in [0, 1] where the points were found by a search; None where somebody gave them."""

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] not in FEWEST:
            raise LandmarkError(
                f"landmarks have shape {tuple(self.points.shape)}, expected (k, 3) or (k, 2)"
            )
        object.__setattr__(self, "points", self.points.to(torch.float64))
        bad = ~torch.isfinite(self.points).all(dim=1)
        if bad.any():
            raise LandmarkError(
                f"landmarks {self._list(bad)} have NaN or infinite coordinates: correct or "
                "delete them"
            )
        if self.confidence is not None:
            self._check_confidence(self.confidence.to(torch.float64))
        if self.names is None:
            return
        if len(self.names) != len(self.points):
            raise LandmarkError(f"{len(self.names)} names for {len(self.points)} landmarks")
        if len(set(self.names)) < len(self.names):
            raise given_twice(self.names)

    def _check_confidence(self, confidence: Tensor) -> None:
        object.__setattr__(self, "confidence", confidence)
        if confidence.shape != self.points.shape[:1]:
            raise LandmarkError(f"{confidence.numel()} confidences for {len(self)} landmarks")
        bad = ~((confidence >= 0) & (confidence <= 1))
        if bad.any():
            raise LandmarkError(f"the confidence of {self._list(bad)} is not between 0 and 1")

    def __len__(self) -> int:
        return int(self.points.shape[0])

    @property
    def dim(self) -> int:
        """2 for images, 3 for splats."""
        return int(self.points.shape[1])

    @staticmethod
    def read(path: str | Path, dim: int = 3) -> Landmarks:
        """Read landmarks; the extension names the format.

        ``.json`` (``{"points": {"name": [x, y, z]}, "confidence": {"name": 0.9}}``, the latter
        only where they were found by a search; lists of points, of objects with name and
        coordinates, 3D Slicer's markups), ``.npy``, ``.npz``, tables (``.csv``, ``.tsv``, ``.txt``,
        ``.xyz``) with names, an index or neither, 3D Slicer's ``.fcsv``, MeshLab's ``.pp``.

        Raises:
            ReadError: the file is missing, of another format, or damaged.
            LandmarkError: the points are no valid set.
        """
        path = Path(path)
        try:
            with reading(path, "landmark file"):
                found = parsed(path, dim)
                array = np.asarray(found.points, dtype=np.float64)
                names = tuple(found.names) if found.names else None
                confidence = _in_order(found.confidence, names)
            if array.ndim != 2 or array.shape[1] != dim or len(array) == 0:
                shape = "x".join(map(str, array.shape)) if array.size else "no points"
                raise ReadError(
                    f"{path} holds {shape}, expected k points of {dim} coordinates each"
                )
            return Landmarks(torch.from_numpy(array), names, confidence)
        except LandmarkError as error:
            raise LandmarkError(f"{path}: {error}") from error

    @staticmethod
    def beside(path: str | Path) -> Path | None:
        """The landmark file that belongs to the input ``path``: ``<stem>.landmarks.*``."""
        path = Path(path)
        for extension in (*READERS, MARKUPS):
            candidate = path.with_name(f"{stem_of(path)}.landmarks{extension}")
            if candidate.is_file():
                return candidate
        return None

    def write(self, path: str | Path) -> None:
        """Write ``.json``, whole or not at all.

        Raises:
            OptionError: another extension.
            WriteError: the file can't be written.
        """
        path = Path(path)
        if path.suffix.lower() != ".json":
            raise OptionError(f"landmarks are written as .json, not {path.name}")
        document: dict[str, Any] = {"points": self._by_name(self.points.tolist())}
        if self.confidence is not None:
            document["confidence"] = self._by_name(self.confidence.tolist())
        with atomic_write(path) as partial:
            partial.write_text(json.dumps(document, indent=1) + "\n")

    def _by_name(self, rows: list[Any]) -> dict[str, Any] | list[Any]:
        return dict(zip(self.names, rows, strict=True)) if self.names else rows

    def moved(self, similarity: Similarity) -> Landmarks:
        """The same points, each at s R x + t."""
        return replace(self, points=similarity(self.points))

    def similarity_to(self, target: Landmarks) -> Similarity:
        """Where the target stands as a whole: what takes these points closest to their partners.

        Raises:
            LandmarkError: see :meth:`match`; or the one set is the mirror image of the other.
        """
        return similarity_between(*self.match(target)[:2])

    def match(self, target: Landmarks) -> tuple[Tensor, Tensor, tuple[str, ...]]:
        """The pairs that both sets have, in the order of this one.

        By name where both have names, else by order (the counts must agree). A pair that repeats
        another in both its points is left out: it says nothing new.

        Returns:
            source points (m, dim), target points (m, dim), their m names.

        Raises:
            LandmarkError: dimensions or counts differ, too few pairs, or one point of either
                side that is to go to two places.
        """
        if self.dim != target.dim:
            raise LandmarkError(f"{self.dim}D landmarks can't be matched to {target.dim}D ones")
        if self.names is not None and target.names is not None:
            where = {name: i for i, name in enumerate(target.names)}
            common = [name for name in self.names if name in where]
            own = {name: i for i, name in enumerate(self.names)}
            source_points = self.points[[own[name] for name in common]]
            target_points = target.points[[where[name] for name in common]]
            _refuse_strangers(self, target, [(own[name], where[name]) for name in common])
        else:
            if len(self) != len(target):
                raise LandmarkError(
                    f"{len(self)} source and {len(target)} target landmarks, matched by order "
                    "since not both have names: expected equal counts, or names in both files"
                )
            names = self.names or target.names
            common = list(names) if names else [str(i) for i in range(len(self))]
            source_points, target_points = self.points, target.points
        kept = _first_of_each(torch.cat([source_points, target_points], dim=1))
        source_points, target_points = source_points[kept], target_points[kept]
        common = [common[i] for i in kept.tolist()]
        _refuse_few(common, self, target)
        _refuse_contradictions(source_points, common, "source")
        _refuse_contradictions(target_points, common, "target")
        return source_points, target_points, tuple(common)

    def given(self, names: Sequence[str]) -> Tensor:
        """(m,) which of the landmarks called so somebody vouches for: all but those found."""
        if self.confidence is None or self.names is None:
            return torch.ones(len(names), dtype=torch.bool)
        sure = dict(zip(self.names, self.confidence.tolist(), strict=True))
        return torch.tensor([sure.get(name, 1.0) >= 1 for name in names])

    def check_near(self, low: Tensor, high: Tensor, what: str) -> None:
        """Refuse points far outside the box from ``low`` to ``high`` (dim,) of the object.

        Far means by more than the box's own diagonal: another unit, frame or object.

        Raises:
            LandmarkError: names the points.
        """
        diagonal = float((high - low).norm())
        beyond = torch.maximum(low - self.points, self.points - high).amax(dim=1)
        far = beyond > diagonal
        if not far.any():
            return
        size = float((self.points.amax(0) - self.points.amin(0)).norm())
        raise LandmarkError(
            f"landmarks {self._list(far)} lie far outside {what} (its box measures "
            f"{diagonal:.3g} corner to corner, the landmarks' {size:.3g}): expected points on the "
            "object, in its units and frame"
        )

    def _list(self, chosen: Tensor) -> str:
        index = chosen.nonzero().flatten().tolist()
        return _some([self.names[i] if self.names else f"number {i}" for i in index])


def _some(names: Sequence[str], most: int = 5) -> str:
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def _first_of_each(rows: Tensor) -> Tensor:
    """Indices, ascending, of the first of each set of equal rows."""
    _, inverse = torch.unique(rows, dim=0, return_inverse=True)
    first = torch.full((int(inverse.max()) + 1 if len(rows) else 0,), len(rows))
    first.scatter_reduce_(0, inverse, torch.arange(len(rows)), "amin")
    return first.sort().values


def _refuse_strangers(source: Landmarks, target: Landmarks, pairs: list[tuple[int, int]]) -> None:
    """Numbers of two searches are equal and mean nothing; one search is equally sure of both."""
    if source.confidence is None or target.confidence is None or source.names is None:
        return
    strange = torch.zeros(len(source), dtype=torch.bool)
    for i, j in pairs:
        found = source.names[i].startswith(FOUND)
        strange[i] = found and bool(source.confidence[i] != target.confidence[j])
    if strange.any():
        raise LandmarkError(
            f"landmarks {source._list(strange)} of the two come from different searches, so that "
            "their names don't correspond: find those of these two anew, or delete them"
        )


def _refuse_few(common: Sequence[str], source: Landmarks, target: Landmarks) -> None:
    needed = FEWEST[source.dim]
    if len(common) >= needed:
        return
    found = f"{len(common)} matched landmark pair{'' if len(common) == 1 else 's'}"
    if common:
        found += f" ({_some(common)})"
    examples = ""
    if source.names and target.names:
        examples = f"; the source has {_some(source.names, 3)}, the target {_some(target.names, 3)}"
    raise LandmarkError(f"{found}, expected at least {needed} with the same names{examples}")


def _refuse_contradictions(points: Tensor, names: Sequence[str], side: str) -> None:
    _, inverse, counts = torch.unique(points, dim=0, return_inverse=True, return_counts=True)
    doubled = counts[inverse] > 1
    if not doubled.any():
        return
    first = int(inverse[doubled.nonzero()[0, 0]])
    same = [name for name, group in zip(names, inverse.tolist(), strict=True) if group == first]
    raise LandmarkError(
        f"landmarks {_some(same)} are one and the same point in the {side} but not in the other "
        "set: no flow can follow both; delete one of them"
    )


def _in_order(confidence: object, names: tuple[str, ...] | None) -> Tensor | None:
    if isinstance(confidence, dict):
        # What a person has added to what was found has none.
        confidence = [confidence.get(name, 1.0) for name in names or ()]
    return None if confidence is None else torch.tensor(confidence, dtype=torch.float64)
