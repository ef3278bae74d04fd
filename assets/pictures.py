"""The README's pictures: ``python assets/pictures.py`` writes those beside it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import splatmorph as sm
from renderer import orbit, write_image
from splatmorph.rendering import bounds
from splatmorph.samples import sample_pair
from splatmorph.view.streamlines import picture, trace
from splatmorph.view.subject import Subject

TIMES = (0.0, 0.25, 0.5, 0.75, 1.0)
AZIMUTHS = (-32.0, -16.0, 0.0, 16.0, 32.0)
SIDE = 540
ROWS, COLUMNS = slice(40, 520), slice(105, 435)
"""What is kept of each frame: the heads without the empty background."""


FLOWS = ("node", "ncf", "ifmorph")


def main() -> None:
    """Fit the sample pair; lay moments of the morph, and three flows, side by side."""
    (source, source_marks), (target, target_marks) = sample_pair()
    p, q, names = source_marks.match(target_marks)
    morphs = []
    for kind in FLOWS:
        flow = sm.make_flow(kind, dim=3)
        sm.fit(flow, source_marks, target_marks, domain=source.means.double())
        morphs.append(sm.Morph(source, target, flow, landmarks=p))
    folder = Path(__file__).parent
    write_image(folder / "morph.png", moments(morphs[0]))
    subjects = [Subject(morph, "Ines", "Otto", p, q, names) for morph in morphs]
    write_image(folder / "streamlines.png", three_flows(subjects))


def moments(morph: sm.Morph) -> NDArray[np.uint8]:
    """Five times of the morph, each seen from another side."""
    around = bounds(morph.source, morph.target)
    cameras = orbit(around, AZIMUTHS, elevation=4, width=SIDE, height=SIDE)
    frames = [
        sm.render(splat, camera)[ROWS, COLUMNS]
        for splat, camera in zip(morph.sequence(TIMES), cameras, strict=True)
    ]
    return np.concatenate(frames, axis=1)


def three_flows(subjects: Sequence[Subject]) -> NDArray[np.uint8]:
    """The streamlines of each flow."""
    view = orbit(subjects[0].bounds(), [30.0], elevation=8, width=SIDE, height=SIDE)[0]
    return picture(subjects, [trace(subject) for subject in subjects], view)


if __name__ == "__main__":
    main()
