"""Correspondences found in the pictures, and the middle frame of a video."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scenes import Turn, painted
from scipy.ndimage import gaussian_filter

from splatmorph.errors import LandmarkError
from splatmorph.fitting import fit
from splatmorph.flows import make_flow
from splatmorph.images import FlowWarp, ImageMorph, Picture
from splatmorph.images.correspond import dense_motion, follow_motion, match_features
from splatmorph.images.quality import psnr
from splatmorph.images.refine import ROOM, refined
from splatmorph.landmarks import Landmarks


def textured(size: int = 256, seed: int = 0) -> Picture:
    """Detail at several sizes, as a photograph has."""
    rng = np.random.default_rng(seed)
    layers = [s * gaussian_filter(rng.standard_normal((size, size)), s) for s in (1, 3, 9)]
    noise = sum(layers)
    values = (noise - noise.min()) / np.ptp(noise)
    return Picture((values[..., None] * 255).astype(np.uint8))


def moved(picture: Picture, angle: float) -> Picture:
    return ImageMorph(picture, picture, FlowWarp(Turn(angle)), interpolation="bicubic").at(-1.0)


@pytest.fixture(scope="module")
def frames() -> list[Picture]:
    """Three frames of a turn about the middle."""
    first = textured()
    return [first, moved(first, -0.03), moved(first, -0.06)]


@pytest.mark.parametrize("find", [match_features, follow_motion])
def test_a_known_motion_is_found(find, frames: list[Picture]) -> None:
    pytest.importorskip("cv2")
    p, q = find(frames[0], frames[2])
    missed = (Turn(0.06)(p.points, 1.0) - q.points).norm(dim=1) / frames[0].canvas.pixel
    assert len(p) >= 30
    assert float(missed.median()) < 0.3
    inner = p.points.norm(dim=1) < 0.8
    assert float(missed[inner].max()) < 2


def test_correspondences_are_the_same_every_time(frames: list[Picture]) -> None:
    pytest.importorskip("cv2")
    again = [match_features(frames[0], frames[2]) for _ in range(2)]
    assert torch.equal(again[0][1].points, again[1][1].points)


def test_the_middle_frame_is_closer_than_a_crossfade(frames: list[Picture]) -> None:
    pytest.importorskip("cv2")
    first, middle, last = frames
    flow = make_flow("node", dim=2)
    fit(flow, *follow_motion(first, last))
    still = make_flow("linear", dim=2)
    inner = slice(32, -32)
    by_flow, by_fade = (
        psnr(
            torch.from_numpy(ImageMorph(first, last, FlowWarp(f)).at(0.5).pixels[inner, inner]),
            torch.from_numpy(middle.as_float().pixels[inner, inner]),
        )
        for f in (flow, still)
    )
    assert by_flow > by_fade + 8


def test_dense_motion_points_from_the_first_to_the_second(frames: list[Picture]) -> None:
    pytest.importorskip("cv2")
    shifted = Picture(np.roll(frames[0].eight_bit(), 3, axis=1))
    motion = dense_motion(Picture(frames[0].eight_bit()), shifted)
    assert np.median(motion[..., 0]) == pytest.approx(3, abs=0.1)


def test_pictures_with_nothing_in_common() -> None:
    pytest.importorskip("cv2")
    flat = Picture(np.full((64, 64, 3), 90, np.uint8))
    for find in (match_features, follow_motion):
        with pytest.raises(LandmarkError, match="expected at least 8"):
            find(flat, flat)
    with pytest.raises(LandmarkError, match="64x64 and 96x64"):
        follow_motion(flat, painted())


def test_what_no_landmark_holds_is_brought_together(frames: list[Picture]) -> None:
    pytest.importorskip("cv2")
    first, last, turn = frames[0], frames[2], Turn(0.06)
    given = torch.tensor([[-0.1, -0.1], [0.1, -0.1], [0.0, 0.1]], dtype=torch.float64)
    pair = Landmarks(given), Landmarks(given + 0.02)
    flow = make_flow("node", dim=2)
    fit(flow, *pair)
    p, q = refined(first, last, FlowWarp(flow), pair)
    assert torch.equal(p.points[:3], given)
    more, pixel = p.points[3:], first.canvas.pixel
    assert len(more) > 50
    missed = (turn(more, 1.0) - q.points[3:]).norm(dim=1) / pixel
    unmoved = (flow(more, 1.0) - turn(more, 1.0)).norm(dim=1) / pixel
    inner = more.norm(dim=1) < 0.8
    assert float(missed[inner].median()) < 0.2 * float(unmoved[inner].median())
    away = torch.cdist(flow(given, 0.5), flow(more, 0.5)).min()
    assert float(away) > 0.8 * ROOM * 2 / 384


def test_pictures_that_meet_stay_as_they_are(frames: list[Picture]) -> None:
    pytest.importorskip("cv2")
    given = torch.tensor([[-0.1, -0.1], [0.1, -0.1], [0.0, 0.1]], dtype=torch.float64)
    pair = Landmarks(given), Landmarks(given)
    p, q = refined(frames[0], frames[0], FlowWarp(make_flow("linear", dim=2)), pair)
    assert float((p.points - q.points).abs().max()) < 1e-6
