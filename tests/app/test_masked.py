"""What a search for landmarks is given to see of splats that have a mask."""

from __future__ import annotations

import numpy as np
import pytest

import splatmorph.registration
import splatmorph.runs.finding
from splatmorph.errors import LandmarkError
from splatmorph.io import write
from splatmorph.registration.masks import Loop, Mask

SEEN_FROM_Z = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 10], [0, 0, 0, 1]])
LOWER_HALF = np.array([[-9.0, 0.0], [9.0, 0.0], [9.0, 9.0], [-9.0, 9.0]])


@pytest.mark.parametrize(
    ("command", "searches"),
    [("landmarks", splatmorph.registration), ("fit", splatmorph.runs.finding)],
)
def test_what_is_left_out_is_not_searched(
    command, searches, cli, make_gaussians, tmp_path, monkeypatch
):
    """The source has a mask over its lower half (y < 0), the target none."""
    seen = []

    def search(source, target, *_, **__):
        seen.extend([source, target])
        raise LandmarkError("seen enough")

    monkeypatch.setattr(searches, "find_landmarks", search)
    splats = [make_gaussians(200, 0, seed) for seed in (1, 2)]
    paths = [tmp_path / "a.ply", tmp_path / "b.ply"]
    for path, splat in zip(paths, splats, strict=True):
        write(path, splat)
    Mask((Loop(SEEN_FROM_Z, LOWER_HALF),)).write(Mask.path_beside(paths[0]))
    code, _, err = cli(command, *paths, "-o", tmp_path / "out")
    assert code == 1
    assert "seen enough" in err
    above = splats[0].means[:, 1] > 0
    assert 0 < above.sum() < 200
    assert np.allclose(seen[0].means, splats[0].means[above])
    assert len(seen[1]) == 200
