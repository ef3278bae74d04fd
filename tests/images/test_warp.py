"""The warp and the morph: laws first."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import Turn, fitted, painted, ruled

from splatmorph.errors import OptionError
from splatmorph.flows import Flow, make_flow
from splatmorph.geometry.similarity import Similarity
from splatmorph.images import Canvas, FlowWarp, ImageMorph, Picture, warp
from splatmorph.images.lattice import Lattice


@pytest.fixture(scope="module")
def flow() -> Flow:
    return fitted()


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_the_ends_are_the_pictures_bit_for_bit(flow: Flow, channels: int) -> None:
    source, target = painted(channels=channels), painted(channels=channels, seed=1)
    morph = ImageMorph(source, target, FlowWarp(flow))
    assert np.array_equal(morph.at(0).eight_bit(), source.eight_bit())
    assert np.array_equal(morph.at(1).eight_bit(), target.eight_bit())


def test_the_sequence_is_every_frame_by_itself(flow: Flow) -> None:
    morph = ImageMorph(painted(), painted(seed=1), FlowWarp(flow))
    times = [0.7, 0.0, 0.25, -0.2, 1.3, 1.0]
    for t, frame in zip(times, morph.sequence(times), strict=True):
        assert np.allclose(frame.pixels, morph.at(t).pixels, atol=1e-4)


def test_swapping_the_pictures_reverses_the_morph() -> None:
    source, target = painted(), painted(seed=1)
    there = ImageMorph(source, target, FlowWarp(Turn(0.4)))
    back = ImageMorph(target, source, FlowWarp(Turn(-0.4)))
    for t in (0.2, 0.5):
        assert np.allclose(there.at(t).pixels, back.at(1 - t).pixels, atol=1e-5)


@given(st.integers(8, 70), st.integers(8, 70))
@settings(max_examples=10, deadline=None)
def test_a_quarter_turn_is_a_quarter_turn(width: int, height: int) -> None:
    source = painted(width, height)
    morph = ImageMorph(source, source, FlowWarp(Turn(math.pi / 2)), Canvas(height, width))
    moved = next(FlowWarp(Turn(math.pi / 2)).maps(morph.output, [1.0]))[0]
    read = warp.sample(source.planes(), source.canvas, moved, morph.output)
    assert np.allclose(Picture.from_planes(read).eight_bit(), np.rot90(source.pixels), atol=1)


def test_beyond_the_ends_the_warp_goes_on() -> None:
    morph = ImageMorph(painted(), painted(seed=1), FlowWarp(Turn(0.3)))
    twice = ImageMorph(painted(), painted(seed=1), FlowWarp(Turn(0.6)))
    assert np.allclose(morph.at(-1).pixels, twice.at(-0.5).pixels, atol=1e-5)


def test_without_motion_it_is_a_crossfade() -> None:
    source, target = painted(), painted(seed=1)
    frame = ImageMorph(source, target, FlowWarp(make_flow("linear", dim=2))).at(0.25)
    mean = 0.75 * source.pixels / 255 + 0.25 * target.pixels / 255
    assert np.allclose(frame.pixels, mean, atol=1e-4)


def test_the_lattice_keeps_to_the_flow(flow: Flow) -> None:
    canvas = Canvas(160, 120)
    warp = FlowWarp(flow, tolerance=0.02)
    assert warp.lattice(canvas)[1] <= 0.02
    maps = next(warp.maps(canvas, [0.6]))
    centers = canvas.centers().reshape(-1, 2).double()
    for pixel_map, t in zip(maps, (-0.6, 0.4), strict=True):
        exact = flow(centers, t)
        found = pixel_map.band(0, canvas.height).reshape(-1, 2)
        assert float((found - exact).norm(dim=1).max()) / canvas.pixel < 0.04


def test_the_lattice_error_falls_with_the_fourth_power() -> None:
    canvas = Canvas(128, 128)
    smooth = lambda x: torch.sin(3 * x + x.flip(1))  # noqa: E731
    errors = []
    for spacing in (16, 8):
        lattice = Lattice(canvas, spacing)
        found = lattice.interpolate(smooth(lattice.points).float())
        errors.append(
            float((found - smooth(canvas.centers().reshape(-1, 2)).view(128, 128, 2)).abs().max())
        )
    assert errors[0] / errors[1] > 10


def test_a_lattice_is_read_alike_by_rows_and_by_pixels() -> None:
    lattice = Lattice(Canvas(50, 30), 7)
    values = torch.randn(2, len(lattice.points), 2, generator=torch.Generator().manual_seed(0))
    x, y = torch.tensor([0, 13, 49]), torch.tensor([29, 4, 0])
    whole = torch.stack([lattice.interpolate(value) for value in values])
    assert torch.allclose(lattice.at_pixels(values, x, y), whole[:, y, x], atol=1e-5)


def test_bands_and_threads_do_not_show(flow: Flow, monkeypatch: pytest.MonkeyPatch) -> None:
    morph = ImageMorph(painted(90, 77), painted(90, 77, seed=1), FlowWarp(flow))
    whole = morph.at(0.5).eight_bit()
    monkeypatch.setattr(warp, "BAND", 16)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        banded = morph.at(0.5).eight_bit()
    finally:
        torch.set_num_threads(threads)
    assert np.array_equal(whole, banded)


def test_long_sequences_go_in_stretches(flow: Flow, monkeypatch: pytest.MonkeyPatch) -> None:
    morph = ImageMorph(painted(), painted(seed=1), FlowWarp(flow))
    times = [0.1, 0.5, 0.9]
    whole = [frame.pixels for frame in morph.sequence(times)]
    monkeypatch.setattr(warp, "BLOCK", 1)
    assert all(
        np.allclose(a, b.pixels, atol=1e-6)
        for a, b in zip(whole, morph.sequence(times), strict=True)
    )


def test_pictures_of_any_size_lie_on_each_other() -> None:
    still = FlowWarp(make_flow("linear", dim=2))
    small, large = ruled(40, 20), ruled(120, 60)
    middle = ImageMorph(small, large, still, Canvas(80, 40)).at(0.5)
    assert np.allclose(middle.pixels, ruled(80, 40).pixels, atol=0.02)
    crossed = ImageMorph(painted(50, 90), painted(90, 50, channels=1), still).at(0.5)
    assert crossed.canvas == Canvas(50, 90)
    assert crossed.channels == 3


def test_the_edge_is_what_was_asked_for() -> None:
    white = Picture(np.full((32, 32, 4), 255, np.uint8))
    turned = {
        edge: ImageMorph(white, white, FlowWarp(Turn(1.0)), edge=edge).at(0.5).pixels
        for edge in ("edge", "reflect", "zero")
    }
    assert turned["edge"][0, 0].min() == turned["reflect"][0, 0].min() == 1
    assert turned["zero"][0, 0, 3] == 0
    assert turned["zero"][16, 16].min() == 1


def test_bicubic_is_closer_than_bilinear() -> None:
    picture = painted(64, 64)
    errors = {}
    for how in ("bilinear", "bicubic"):
        there = ImageMorph(picture, picture, FlowWarp(Turn(0.2)), interpolation=how).at(-1.0)
        back = ImageMorph(there, there, FlowWarp(Turn(-0.2)), interpolation=how).at(-1.0)
        missed = np.abs(back.pixels - picture.pixels / 255)[16:-16, 16:-16]
        errors[how] = missed.mean()
    assert errors["bicubic"] < 0.5 * errors["bilinear"]


def test_tiny_pictures_morph() -> None:
    one = Picture(np.full((1, 1, 3), 100, np.uint8))
    other = Picture(np.full((1, 1, 3), 200, np.uint8))
    middle = ImageMorph(one, other, FlowWarp(Turn(0.1))).at(0.5)
    assert np.array_equal(middle.eight_bit(), np.full((1, 1, 3), 150, np.uint8))


def test_unknown_words_are_refused() -> None:
    for option in ({"edge": "wrap"}, {"interpolation": "nearest"}):
        with pytest.raises(OptionError, match="is unknown"):
            ImageMorph(painted(), painted(), FlowWarp(Turn(0.1)), **option).at(0.5)


def test_a_frame_is_played_from_one_picture_to_the_other() -> None:
    frame = Similarity(torch.tensor([[0.0, -1.0], [1.0, 0.0]]), 2.0, torch.tensor([0.3, -0.1]))
    apart = FlowWarp(Turn(0.2), frame)
    canvas, x = Canvas(48, 32), torch.tensor([[0.1, 0.2], [-0.3, 0.1]])
    centers = canvas.centers().reshape(-1, 2)
    for t, (source, target) in zip((0.0, 0.4, 1.0), apart.maps(canvas, [0, 0.4, 1]), strict=True):
        start = frame.power(t).inverse()(centers)
        exact = Turn(0.2)(start, -t), frame(Turn(0.2)(start, 1 - t))
        for found, expected in zip((source, target), exact, strict=True):
            read = found.band(0, canvas.height).reshape(-1, 2)
            assert float((read - expected).norm(dim=1).max()) < 0.1 * canvas.pixel
    torch.testing.assert_close(apart.carry(x, 1.0), frame(Turn(0.2)(x, 1.0)))
    source, target = painted(), painted(seed=1)
    morph = ImageMorph(source, target, apart)
    assert np.array_equal(morph.at(1).eight_bit(), target.eight_bit())
