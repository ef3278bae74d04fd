"""The transpose of the rasterizer, on both paths, and its laws."""

from __future__ import annotations

import numpy as np
import pytest
from random_scenes import pinhole, random_scene

from renderer import ArgumentError, gather, rasterize
from renderer.reference import gather_reference

pytestmark = pytest.mark.usefixtures("each_path")


def shapes_and_camera(n: int, seed: int, size: tuple[int, int]):
    scene = random_scene(n, 0, seed)
    camera = pinhole(*size)
    camera.pop("width"), camera.pop("height")
    return scene, {name: scene[name] for name in scene if name != "sh"} | camera


def values(size: tuple[int, int], channels: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(size[1], size[0], channels)).astype(np.float32)


@pytest.mark.parametrize("size", [(1, 1), (17, 33), (70, 70), (100, 3)])
@pytest.mark.parametrize("channels", [1, 4, 11])
def test_random_scenes_equal_the_reference(size, channels):
    _, given = shapes_and_camera(50, 3, size)
    picture = values(size, channels)
    found, wanted = gather(**given, pictures=picture), gather_reference(**given, picture=picture)
    assert found.shape == (50, channels)
    # A threshold flip moves at most 0.01 of a pixel.
    assert np.abs(found - wanted).max() <= 0.05
    assert np.abs(found - wanted).mean() <= 1e-3


def test_it_is_the_transpose_of_the_picture():
    scene, given = shapes_and_camera(80, 5, (60, 50))
    picture = values((60, 50), 3)
    rgb, _, _ = rasterize(**scene, **pinhole(60, 50))
    colours = np.maximum(0.5 + 0.28209479177387814 * scene["sh"][:, 0], 0)
    there, here = (rgb * picture).sum(), (colours * gather(**given, pictures=picture)).sum()
    assert there == pytest.approx(here, rel=1e-4)


def test_shares_of_a_pixel_add_up_to_its_alpha():
    scene, given = shapes_and_camera(80, 6, (40, 40))
    _, alpha, _ = rasterize(**scene, **pinhole(40, 40))
    assert gather(**given, pictures=np.ones((40, 40, 1))).sum() == pytest.approx(alpha.sum(), 1e-4)


def test_cameras_are_summed_and_threads_change_no_bit():
    _, given = shapes_and_camera(60, 7, (50, 40))
    several = np.stack([values((50, 40), 2, seed) for seed in (1, 2)])
    both = given | {"viewmat": np.stack([given["viewmat"]] * 2)}
    found = gather(**both, pictures=several)
    assert np.allclose(found, sum(gather(**given, pictures=one) for one in several), atol=1e-5)
    assert np.array_equal(found, gather(**both, pictures=several, threads=1))


def test_in_slabs(small_lists):
    _, given = shapes_and_camera(500, 8, (64, 64))
    picture = values((64, 64), 2)
    whole = gather(**given, pictures=picture)
    small_lists(64)
    assert np.allclose(whole, gather(**given, pictures=picture), atol=1e-4)


def test_nothing_to_gather_from():
    _, given = shapes_and_camera(0, 9, (8, 8))
    assert gather(**given, pictures=values((8, 8), 2)).shape == (0, 2)


@pytest.mark.parametrize(
    ("pictures", "said"),
    [
        (np.zeros((8, 8)), r"pictures has shape \(8, 8\)"),
        (np.zeros((8, 8, 0)), "pictures has shape"),
        (np.zeros((2, 8, 8, 1)), "2 pictures and 1 cameras"),
        (np.full((8, 8, 1), np.nan), "not finite"),
    ],
)
def test_pictures_that_cant_be_used(pictures, said):
    _, given = shapes_and_camera(5, 10, (8, 8))
    with pytest.raises(ArgumentError, match=said):
        gather(**given, pictures=pictures)
