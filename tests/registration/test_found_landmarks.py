"""Landmarks that are found on splats whose true correspondence is known."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import splatmorph as sm
from splatmorph.errors import LandmarkError, OptionError
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.quaternions import matrices_from_axis_angles
from splatmorph.geometry.similarity import Similarity
from splatmorph.landmarks import Landmarks
from splatmorph.registration import find_landmarks, refine_landmarks

ASSETS = Path(__file__).parents[2] / "assets"


@pytest.fixture(autouse=True)
def _fewer_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """A third of the samples: rougher, and quick."""
    from splatmorph.registration import search, subject

    monkeypatch.setattr(search, "prepare", partial(subject.prepare, samples=900))


@pytest.fixture(scope="module")
def head() -> Gaussians:
    """A head of few splats, so that rendering it is quick."""
    return sm.read(ASSETS / "ines.ply")


def swollen(x: Tensor) -> Tensor:
    """A face a fifth larger about its middle, and a head bent a little."""
    middle = torch.tensor([0.0, -0.03, 0.08], dtype=x.dtype)
    from_middle = x - middle
    near = torch.exp(-from_middle.square().sum(1, keepdim=True) / 0.07**2)
    bent = torch.zeros_like(x)
    bent[:, 0] = 0.3 * x[:, 1].clamp_min(-0.1).square()
    return x + 0.2 * near * from_middle + bent


POSE = Similarity(
    matrices_from_axis_angles(torch.tensor([1.9, -0.8, 1.2], dtype=torch.float64)),
    2.3,
    torch.tensor([0.4, -3.0, 1.0]),
)


@pytest.fixture(scope="module")
def posed(head: Gaussians) -> Gaussians:
    """The same head, its face swollen, turned far, scaled, moved, in another order."""
    warped = replace(head, means=swollen(head.means))
    order = torch.randperm(len(head), generator=torch.Generator().manual_seed(1))
    return warped.moved(POSE).select(order)


def true_errors(found: tuple[Landmarks, Landmarks]) -> Tensor:
    """How far each landmark lies from where it should, metres of the unposed head."""
    p, q, _ = found[0].match(found[1])
    return (POSE.inverse()(q) - swollen(p)).norm(dim=1)


def test_any_pose_and_a_known_warp_are_found_by_surfaces(head: Gaussians, posed: Gaussians) -> None:
    found = find_landmarks(head, posed, "surface", count=300)
    errors = true_errors((found.source, found.target))
    assert len(errors) == 300
    assert float(errors.mean()) < 0.004  # of .1 m; the warp moves by up to .02
    assert all(name.startswith("auto_") for name in found.source.names or ())
    assert found.source.confidence is not None
    half = found.source.confidence.median()
    sure, doubtful = (errors[one] for one in (found.source.confidence > half,
                                              found.source.confidence <= half))  # fmt: skip
    assert float(sure.mean()) < float(doubtful.mean())


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores can't be taken away here")
def test_the_bits_are_the_same_on_one_core_as_on_all(head: Gaussians, posed: Gaussians) -> None:
    threads, cores = torch.get_num_threads(), os.sched_getaffinity(0)
    ends = []
    try:
        for some, used in ((1, {min(cores)}), (2, cores)):
            torch.set_num_threads(some)
            os.sched_setaffinity(0, used)
            found = find_landmarks(head, posed, "surface", count=40)
            ends.append((found.source.points, found.target.points, found.source.confidence))
            assert torch.get_num_threads() == some
    finally:
        os.sched_setaffinity(0, cores)
        torch.set_num_threads(threads)
    for one, other in zip(*ends, strict=True):
        assert torch.equal(one, other)


def test_few_landmarks_are_kept_and_added_to(head: Gaussians, posed: Gaussians) -> None:
    p = Landmarks.read(ASSETS / "ines.landmarks.json")
    few = slice(0, len(p), 24)
    names = (p.names or ())[few]
    given = Landmarks(p.points[few], names), Landmarks(POSE(swollen(p.points[few])), names)
    found = refine_landmarks(head, posed, given, count=300)
    for before, after in zip(given, (found.source, found.target), strict=True):
        kept = [(after.names or ()).index(name) for name in names]
        assert torch.equal(after.points[kept], before.points)
    assert len(found.source) > 150
    assert float(true_errors((found.source, found.target)).mean()) < 0.004


def test_a_face_is_found_in_any_pose(head: Gaussians, posed: Gaussians, shared_data: Path) -> None:
    pytest.importorskip("cv2")
    model = shared_data / "models" / "face_landmarker.task"
    if not model.is_file():
        pytest.skip("the face model is not here")
    source, target = sm.correspond(head, posed, "face", face_model=model)
    assert len(source) > 300
    assert float(true_errors((source, target)).median()) < 0.004


def test_nothing_to_see_is_said() -> None:
    dust = Gaussians(
        means=torch.rand(500, 3),
        quats=torch.tensor([1.0, 0, 0, 0]).expand(500, 4),
        log_scales=torch.full((500, 3), math.log(1e-3)),
        opacity_logits=torch.full((500,), -3.0),
        sh=torch.zeros(500, 1, 3),
    )
    with pytest.raises(LandmarkError, match="solid surface"):
        find_landmarks(dust, dust, "surface")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"method": "magic"}, "method"),
        ({"count": 3}, "count"),
        ({"crop": (5, 5, 5, 6, 6, 6)}, "no splat of the source"),
    ],
)
def test_bad_options_are_named(head: Gaussians, change: dict, said: str) -> None:
    with pytest.raises(OptionError, match=said):
        find_landmarks(head, head, **{"method": "surface", **change})


def test_a_missing_model_says_how_to_get_it(
    head: Gaussians, monkeypatch: pytest.MonkeyPatch
) -> None:
    from splatmorph.registration import face_network

    monkeypatch.delenv(face_network.VARIABLE, raising=False)
    monkeypatch.setattr(face_network, "CARRIERS", ("no_such_package",))
    with pytest.raises(sm.SplatmorphError, match="pip install"):
        face_network.find_model()
    with pytest.raises(sm.SplatmorphError, match="not there"):
        face_network.find_model("nowhere.task")


def test_a_file_that_is_no_model_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    from splatmorph.registration.face_network import FaceNetwork

    path = tmp_path / "face_landmarker.task"
    for content in (b"", b"PK\x03\x04 damaged", np.arange(999, dtype=np.uint8).tobytes()):
        path.write_bytes(content)
        with pytest.raises(sm.SplatmorphError, match=r"face_landmarker\.task"):
            FaceNetwork(path)
