"""Reading pictures: every kind, upright, and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scenes import painted

from splatmorph.errors import ReadError, TooLargeError
from splatmorph.images import Canvas, Picture

SIDES = st.integers(1, 5000)


@given(SIDES, SIDES)
def test_the_longer_side_runs_from_minus_one_to_one(width: int, height: int) -> None:
    canvas = Canvas(width, height)
    corners = canvas.to_world(torch.tensor([[0.0, 0.0], [width, height]], dtype=torch.float64))
    half = torch.tensor(canvas.half, dtype=torch.float64)
    assert max(canvas.half) == pytest.approx(1)
    assert torch.allclose(corners, torch.stack([half, half]) * torch.tensor([[-1, 1], [1, -1]]))


@given(SIDES, SIDES, st.integers(0, 99))
def test_pixels_to_world_and_back(width: int, height: int, seed: int) -> None:
    canvas = Canvas(width, height)
    points = torch.rand(5, 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    assert torch.allclose(canvas.to_world(canvas.to_pixels(points)), points, atol=1e-12)


def test_the_border_has_its_corners_once() -> None:
    canvas = Canvas(40, 20)
    assert sorted(canvas.border(1).tolist()) == [[-1, -0.5], [-1, 0.5], [1, -0.5], [1, 0.5]]
    assert len(torch.unique(canvas.border(5), dim=0)) == 20


@pytest.mark.parametrize(
    ("mode", "channels"),
    [("1", 1), ("L", 1), ("P", 3), ("RGB", 3), ("CMYK", 3), ("LA", 4), ("RGBA", 4)],
)
def test_every_mode_is_read(tmp_path: Path, mode: str, channels: int) -> None:
    image = Image.fromarray(painted().pixels).convert(mode)
    path = tmp_path / ("picture.tiff" if mode == "CMYK" else "picture.png")
    image.save(path)
    picture = Picture.read(path)
    assert picture.channels == channels
    expected = np.asarray(image.convert({1: "L", 3: "RGB", 4: "RGBA"}[channels]))
    assert np.array_equal(picture.pixels.squeeze(), expected)


def test_sixteen_bit_grey_is_kept(tmp_path: Path) -> None:
    values = np.arange(12, dtype=np.uint16).reshape(3, 4) * 5000
    Image.fromarray(values).save(tmp_path / "deep.png")
    picture = Picture.read(tmp_path / "deep.png")
    assert np.array_equal(picture.pixels[..., 0], values)
    assert picture.planes()[0, 2, 3] == pytest.approx(55000 / 65535)


@pytest.mark.parametrize("name", ["deep.png", "deep.tiff"])
def test_sixteen_bit_colour_is_kept(tmp_path: Path, name: str) -> None:
    cv2 = pytest.importorskip("cv2")
    values = np.random.default_rng(0).integers(0, 65536, (5, 4, 3)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / name), values[..., ::-1])
    assert np.array_equal(Picture.read(tmp_path / name).pixels, values)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("deep", [False, True])
def test_exif_turns_pictures_upright(tmp_path: Path, orientation: int, deep: bool) -> None:
    upright = painted(6, 4, channels=1).pixels
    undo = {2: "FLIP_LEFT_RIGHT", 3: "ROTATE_180", 4: "FLIP_TOP_BOTTOM", 5: "TRANSPOSE",
            6: "ROTATE_90", 7: "TRANSVERSE", 8: "ROTATE_270"}  # fmt: skip
    stored = Image.fromarray(upright[..., 0])
    if orientation > 1:
        stored = stored.transpose(Image.Transpose[undo[orientation]])
    if deep:
        upright = upright.astype(np.uint16) * 257
        stored = Image.fromarray(np.asarray(stored).astype(np.uint16) * 257)
    exif = Image.Exif()
    exif[0x0112] = orientation
    stored.save(tmp_path / "turned.png", exif=exif)
    assert np.array_equal(Picture.read(tmp_path / "turned.png").pixels, upright)


def test_alpha_is_premultiplied_and_back() -> None:
    picture = painted(channels=4)
    back = Picture.from_planes(picture.planes()).eight_bit()
    seen = picture.pixels[..., 3] > 0
    assert np.array_equal(back[seen], picture.pixels[seen])
    assert np.array_equal(back[..., 3], picture.pixels[..., 3])


def test_channels_are_added_and_alpha_dropped() -> None:
    grey = painted(channels=1)
    assert (grey.with_channels(4).pixels[..., 3] == 255).all()
    assert np.array_equal(grey.with_channels(4).with_channels(3).pixels, grey.rgb())


def test_reducing_does_not_alias() -> None:
    stripes = np.zeros((64, 64, 1), np.uint8)
    stripes[:, ::2] = 255
    small = Picture(stripes).planes(Canvas(16, 16))
    assert small.shape == (1, 16, 16)
    assert torch.allclose(small[0, :, 2:-2], torch.tensor(0.5), atol=0.02)


def test_one_pixel_is_a_picture(tmp_path: Path) -> None:
    Image.new("RGB", (1, 1), (9, 8, 7)).save(tmp_path / "one.png")
    picture = Picture.read(tmp_path / "one.png")
    assert picture.canvas == Canvas(1, 1)
    assert picture.planes(Canvas(1, 1)).shape == (3, 1, 1)


def test_what_is_no_picture_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match=r"can't read .*missing\.png: No such file"):
        Picture.read(tmp_path / "missing.png")
    (tmp_path / "text.png").write_text("not a picture")
    with pytest.raises(ReadError, match="no picture that we can read"):
        Picture.read(tmp_path / "text.png")
    Image.fromarray(painted().pixels).save(tmp_path / "whole.png")
    (tmp_path / "cut.png").write_bytes((tmp_path / "whole.png").read_bytes()[:400])
    with pytest.raises(ReadError, match=r"cut\.png"):
        Picture.read(tmp_path / "cut.png")
    Image.fromarray(np.zeros((4, 4), np.float32)).save(tmp_path / "float.tiff")
    with pytest.raises(ReadError, match="floating-point"):
        Picture.read(tmp_path / "float.tiff")


def test_animations_are_refused(tmp_path: Path) -> None:
    frames = [Image.new("RGB", (8, 8), (shade, 0, 0)) for shade in (0, 128, 255)]
    frames[0].save(tmp_path / "film.gif", save_all=True, append_images=frames[1:])
    with pytest.raises(ReadError, match=r"animated, expected one"):
        Picture.read(tmp_path / "film.gif")


def test_large_pictures_are_read_and_huge_ones_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Image.new("L", (100, 150)).save(tmp_path / "large.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1_000)  # Pillow's limit is not ours
    assert Picture.read(tmp_path / "large.png").canvas == Canvas(100, 150)
    with pytest.raises(TooLargeError, match="100x150 pixels, expected at most 14,999"):
        Picture.read(tmp_path / "large.png", max_pixels=14_999)
    assert Image.MAX_IMAGE_PIXELS == 1_000
