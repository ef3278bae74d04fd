"""Scene: what a viewer shows, be it one splat, a morph of two or a chain of several."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from renderer import Bounds
from splatmorph.avatars import is_avatar
from splatmorph.errors import OptionError
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.similarity import Similarity
from splatmorph.morph.chain import Chain
from splatmorph.rendering import bounds
from splatmorph.runs.inputs import load_splat
from splatmorph.runs.run import open_run
from splatmorph.view.subject import Subject


@dataclass(frozen=True)
class Scene:
    """Splats in a row, and the morphs that lead from each to the next."""

    splats: tuple[Gaussians, ...]
    names: tuple[str, ...]
    legs: tuple[Subject, ...] = ()
    """One less than splats: t goes from 0 at the first splat to their count at the last."""

    @staticmethod
    def of(subject: Subject) -> Scene:
        """The scene of a single morph."""
        morph = subject.morph
        names = (subject.source_name, subject.target_name)
        return Scene((morph.source, morph.target), names, (subject,))

    @property
    def places(self) -> list[Similarity]:
        """Where the source of each leg is shown: in its own place, or where the leg before ends."""
        places = [Similarity.identity()]
        for leg in self.legs:
            here, frame = places[-1], leg.morph.frame
            places.append(here @ frame.inverse() if leg.morph.stay else here)
        return places[: len(self.legs)]

    @property
    def title(self) -> str:
        """All names."""
        return " → ".join(self.names)

    def bounds(self) -> Bounds:
        """The sphere round all splats, floaters left out."""
        ends = [leg.end.moved(to) for leg, to in zip(self.legs, self.places, strict=True)]
        return bounds(self.splats[0], *ends)


def open_scene(what: str | Path, **options: Any) -> Scene:
    """The scene of a splat file, an avatar or a run directory; ``options`` are ``Morph``'s.

    A run of an average is the one splat that is the average; others are shown in the place of
    their first splat, wherever the captures stand.

    Raises:
        ReadError: the splat can't be read.
        RunError: the directory is no run, or its inputs have moved or changed.
        OptionError: an unknown ramp or covariance, or any of them for what has no t.
    """
    what = Path(what)
    if not what.is_dir() or is_avatar(what):
        if options:
            raise OptionError(f"{what} is one splat, which has no {min(options)}: expected a run")
        loaded = load_splat(what)
        return Scene((loaded.gaussians,), (loaded.name,))
    run = open_run(what)
    inputs = run.load_inputs()
    names = tuple(one.name for one in inputs)
    if run.is_mean:
        return Scene((run.average(inputs, **options),), (f"mean of {', '.join(names)}",))
    whole = run.morph(inputs, stay=True, **options)
    morphs = whole.morphs if isinstance(whole, Chain) else (whole,)
    legs = tuple(
        Subject(morph, *ends, leg.source_points, leg.target_points, leg.names)
        for morph, ends, leg in zip(morphs, pairwise(names), run.legs, strict=True)
    )
    return Scene(tuple(one.gaussians for one in inputs), names, legs)
