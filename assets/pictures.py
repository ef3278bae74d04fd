"""The README's picture: ``python assets/pictures.py`` writes ``assets/morph.png``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import splatmorph as sm
from renderer import orbit, write_image
from splatmorph.rendering import bounds
from splatmorph.samples import sample_pair

TIMES = (0.0, 0.25, 0.5, 0.75, 1.0)
AZIMUTHS = (-32.0, -16.0, 0.0, 16.0, 32.0)
SIDE = 540
ROWS, COLUMNS = slice(40, 520), slice(105, 435)
"""What is kept of each frame: the heads without the empty background."""


def main() -> None:
    """Fit the sample pair and lay five moments of the morph side by side."""
    (source, source_marks), (target, target_marks) = sample_pair()
    flow = sm.make_flow("node", dim=3)
    sm.fit(flow, source_marks, target_marks, domain=source.means.double())
    morph = sm.Morph(source, target, flow)
    cameras = orbit(bounds(source, target), AZIMUTHS, elevation=4, width=SIDE, height=SIDE)
    frames = [
        sm.render(splat, camera)[ROWS, COLUMNS]
        for splat, camera in zip(morph.sequence(TIMES), cameras, strict=True)
    ]
    write_image(Path(__file__).with_name("morph.png"), np.concatenate(frames, axis=1))


if __name__ == "__main__":
    main()
