"""The sample pair: what a splat, its landmarks and a pair of people owe the reader."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from splatmorph.gaussians import Gaussians
from splatmorph.io import read
from splatmorph.landmarks import Landmarks
from splatmorph.samples import sample_pair
from splatmorph.samples.bust import portray
from splatmorph.samples.marks import landmarks
from splatmorph.samples.people import INES, OTTO

ASSETS = Path(__file__).parents[2] / "assets"
NAMES = (INES.name, OTTO.name)


@pytest.fixture(scope="module")
def pair() -> dict[str, tuple[Gaussians, Landmarks]]:
    return dict(zip(NAMES, sample_pair(), strict=True))


@pytest.mark.parametrize("name", NAMES)
def test_landmarks_lie_on_the_splats(pair: dict, name: str) -> None:
    gaussians, marks = pair[name]
    gap, _ = cKDTree(gaussians.means.numpy()).query(marks.points.numpy())
    assert np.median(gap) < 0.0015
    assert gap.max() < 0.007, marks.names[int(gap.argmax())]


def test_both_people_have_the_same_landmarks(pair: dict) -> None:
    source, target = (pair[name][1] for name in NAMES)
    assert source.names == target.names
    assert len(source) >= 60
    p, q, _ = source.match(target)
    assert (p - q).norm(dim=1).max() < 0.06


@pytest.mark.parametrize("name", NAMES)
def test_landmarks_of_the_halves_mirror_each_other(pair: dict, name: str) -> None:
    marks = pair[name][1]
    where = dict(zip(marks.names, marks.points, strict=True))
    for name, point in where.items():
        if name.endswith("_left"):
            mirror = where[name.removesuffix("_left") + "_right"]
            torch.testing.assert_close(mirror, point * torch.tensor([-1.0, 1, 1]).double())
            assert point[0] > 0


@pytest.mark.parametrize("name", NAMES)
def test_the_face_is_where_faces_are(pair: dict, name: str) -> None:
    marks = pair[name][1]
    where = dict(zip(marks.names, marks.points.numpy(), strict=True))
    order = ["hair_crown", "brow_arch_left", "pupil_left", "nose_tip", "lip_parting", "chin_bottom"]
    heights = [where[name][1] for name in order]
    assert heights == sorted(heights, reverse=True)
    assert 0.2 < heights[0] - heights[-1] < 0.27
    assert max(where, key=lambda name: where[name][2]) == "nose_tip"


@pytest.mark.parametrize("name", NAMES)
def test_splats_are_flat_opaque_and_shine(pair: dict, name: str) -> None:
    gaussians, _ = pair[name]
    assert 15_000 <= len(gaussians) <= 40_000
    scales = gaussians.scales.sort(dim=1).values
    assert (scales[:, 0] < 0.5 * scales[:, 1]).float().mean() > 0.99
    assert gaussians.opacities.min() > 0.9
    torch.testing.assert_close(gaussians.quats.norm(dim=1), torch.ones(len(gaussians)))
    assert gaussians.sh_degree == 1
    assert (gaussians.sh[:, 1:].abs().amax((1, 2)) > 0.01).float().mean() > 0.9


@pytest.mark.parametrize("name", NAMES)
def test_colours_stay_in_range_from_every_side(pair: dict, name: str) -> None:
    gaussians, _ = pair[name]
    base = 0.5 + 0.28209479 * gaussians.sh[:, 0]
    swing = 0.48860251 * gaussians.sh[:, 1:].norm(dim=1)
    assert torch.isfinite(gaussians.sh).all()
    assert base.min() > -0.05
    assert base.max() < 1.3
    assert swing.max() < 0.7


def test_a_splat_is_the_same_on_every_call(pair: dict) -> None:
    again = portray(INES)
    first = pair[INES.name][0]
    for field in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        assert torch.equal(getattr(again, field), getattr(first, field))


def test_the_people_differ(pair: dict) -> None:
    (a, marks_a), (b, marks_b) = (pair[name] for name in NAMES)
    p, q, names = marks_a.match(marks_b)
    face = [i for i, name in enumerate(names) if name.startswith(("nose", "jaw", "lip", "chin"))]
    assert (p - q).norm(dim=1)[face].mean() > 0.004
    assert (a.sh[:, 0].mean(0) - b.sh[:, 0].mean(0)).norm() > 0.3


def test_a_parameter_moves_its_landmark() -> None:
    longer = replace(INES, nose_tip=(0, -34, 121))
    before, after = landmarks(INES), landmarks(longer)
    moved = dict(zip(before.names, (after.points - before.points).norm(dim=1), strict=True))
    assert moved["nose_tip"] == pytest.approx(0.010, abs=0.001)
    assert moved["ear_top_left"] == 0


@pytest.mark.parametrize("name", NAMES)
def test_assets_are_what_the_code_makes(pair: dict, name: str) -> None:
    """To a splat's size: another processor rounds otherwise and may keep or drop a splat."""
    gaussians, marks = pair[name]
    stored = read(ASSETS / f"{name}.ply")
    stored_marks = Landmarks.read(ASSETS / f"{name}.landmarks.json")
    assert stored_marks.names == marks.names
    torch.testing.assert_close(stored_marks.points, marks.points, rtol=0, atol=1e-5)
    assert abs(len(stored) - len(gaussians)) < 0.01 * len(gaussians)
    gap, nearest = cKDTree(stored.means.numpy()).query(gaussians.means.numpy())
    assert np.median(gap) < 1e-3
    assert gap.max() < 0.01
    tint = (stored.sh[nearest, 0] - gaussians.sh[:, 0]).abs()
    assert tint.median() < 0.1


def test_assets_are_small() -> None:
    sizes = [path.stat().st_size for name in NAMES for path in ASSETS.glob(f"{name}.*")]
    assert len(sizes) == 4
    assert sum(sizes) < 8_000_000
