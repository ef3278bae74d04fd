"""One morph of a scene as a page carries it: where its halves go, and what they take on."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from splatmorph.geometry.harmonics import rotate_sh
from splatmorph.geometry.similarity import Similarity
from splatmorph.morph.agreement.fade import DENSEST_STACK
from splatmorph.morph.morph import BLENDS
from splatmorph.view.knots import FINEST, knot_times
from splatmorph.view.page.coding import Table
from splatmorph.view.page.motion import Motion
from splatmorph.view.page.palette import Palette
from splatmorph.view.subject import Subject


class Leg:
    """A morph shown at a place, of whose source and target the splats at those indices are."""

    def __init__(self, subject: Subject, place: Similarity, source: Tensor, target: Tensor) -> None:
        morph = subject.morph
        self.subject, self.place = subject, place
        self.agrees = BLENDS[morph.blend]
        self.halves = (morph.source.select(source), morph.aligned.select(target))
        self.agreed = [
            one.select(index)
            for one, index in zip(morph.agreement(), (source, target), strict=True)
        ]
        self.own = (self.halves[0], morph.target.select(target))

    @property
    def others(self) -> Tensor:
        """(n, k, 3) harmonics that the halves have at their other ends, each in its own frame."""
        changes = [one.drift.sh for one in self.agreed]
        # The target took them on in the source's place.
        changes[1] = rotate_sh(changes[1], self.subject.morph.frame.rotation)
        taken = [one.taken(half) for one, half in zip(self.agreed, self.own, strict=True)]
        return torch.cat([half.sh + sh for half, sh in zip(taken, changes, strict=True)])

    def packed(self, pixel: float, palette: Palette) -> tuple[dict[str, Table], dict[str, Any]]:
        """The tables and the facts, for a picture whose pixels measure so many world units."""
        subject, away = self.subject, self.subject.morph.frame.inverse()
        motion = Motion(subject.morph, self.halves, [one.drift for one in self.agreed], pixel)
        moves, move_step = motion.moves()
        shapes, shape_step = motion.shapes()
        tables = {"moves": moves, "deforms": shapes}
        if self.agrees:
            tables |= self._agreement(palette)
        facts = {
            "knots": motion.times.tolist(),
            "moveScale": move_step.tolist(),
            "deformScale": shape_step,
            "base": None if away.is_identity else _rows(away),
            "frame": _frame(subject, self.place),
            "error": motion.error(moves, move_step),
            "landmarks": {
                "names": list(subject.landmark_names),
                "source": motion.landmarks(subject.source_points, 0),
                "target": motion.landmarks(away(subject.target_points), 1),
            },
        }
        return tables, facts

    def _agreement(self, palette: Palette) -> dict[str, Table]:
        """Colours at the other end, the lead in 256ths, the density of the stack by its root."""
        lead = torch.cat([one.lead for one in self.agreed]).double().numpy(force=True)
        density = torch.cat([one.density for one in self.agreed]).double().numpy(force=True)
        leads = np.rint(256 * lead).clip(1, 255).astype(np.uint8)
        roots = np.rint(255 * np.sqrt(density / DENSEST_STACK)).astype(np.uint8)
        others = self.others
        return {
            "others": Table(np.column_stack([palette.colours(others), leads])),
            "otherShades": Table(palette.shades(others)),
            "densities": Table(roots[:, None]),
        }


def _rows(similarity: Similarity) -> list[list[float]]:
    """s R and the shift beside it, three rows of four."""
    moved = torch.cat([similarity.scale * similarity.rotation, similarity.shift[:, None]], 1)
    return [list(map(float, row)) for row in moved]


def _frame(subject: Subject, place: Similarity) -> dict[str, Any] | None:
    """What carries both halves, at the knots of a polynomial; None where nothing does."""
    morph = subject.morph
    if morph.stay or morph.frame.is_identity:
        return None if place.is_identity else {"knots": [0.0], "rows": [_rows(place)]}
    knots = knot_times(FINEST)
    rows = [_rows(place @ morph.frame.power(float(t))) for t in knots]
    return {"knots": knots.tolist(), "rows": rows}
