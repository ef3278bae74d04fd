"""Pictures and videos: whole, or not there."""

from __future__ import annotations

import subprocess
import threading

import imageio.v3 as imageio
import imageio_ffmpeg
import numpy as np
import pytest

from renderer import OutputError, to_bytes, video, write_image, write_video


def frames(count=6, height=24, width=32):
    for i in range(count):
        frame = np.zeros((height, width, 3), np.uint8)
        frame[:, : width * (i + 1) // count] = [250, 120, 30]
        yield frame


def decoded(path, height, width):
    """All frames of a video, by ffmpeg itself."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24"]
    raw = subprocess.run([*command, "-"], capture_output=True, check=True).stdout
    return np.frombuffer(raw, np.uint8).reshape(-1, height, width, 3)


@pytest.mark.parametrize("name", ["a.mp4", "a.mov", "a.mkv", "a.webm"])
@pytest.mark.parametrize("size", [(24, 32), (25, 33), (1, 1)])
def test_videos_read_back_with_even_sides(tmp_path, size, name):
    path = write_video(tmp_path / name, frames(6, *size), 20)
    assert path == tmp_path / name
    found = decoded(path, size[0] + size[0] % 2, size[1] + size[1] % 2)
    assert len(found) == 6
    assert abs(int(found[-1][0, 0, 0]) - 250) < 25
    assert [file.name for file in tmp_path.iterdir()] == [name]


def test_gifs_read_back(tmp_path):
    path = write_video(tmp_path / "a.gif", frames(6, 25, 33), 20)
    found = imageio.imread(path, index=None)
    assert found.shape[:3] == (6, 25, 33)
    assert abs(int(found[-1][0, 0, 0]) - 250) < 25
    assert [file.name for file in tmp_path.iterdir()] == ["a.gif"]


def test_a_folder_of_frames_and_again(tmp_path):
    folder = tmp_path / "frames"
    write_video(folder, frames(5), 20)
    write_video(folder, frames(3), 20)
    assert sorted(file.name for file in folder.iterdir()) == [
        f"frame_{i:04d}.png" for i in range(3)
    ]
    np.testing.assert_array_equal(imageio.imread(folder / "frame_0002.png"), list(frames(3))[2])
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"notes\.txt"):
        write_video(folder, frames(2), 20)
    assert (folder / "notes.txt").exists()
    assert len(list(folder.iterdir())) == 4


def test_frames_of_a_folder_may_be_transparent(tmp_path):
    write_video(tmp_path / "clear", [np.full((4, 4, 4), 9, np.uint8)])
    assert imageio.imread(tmp_path / "clear" / "frame_0000.png").shape == (4, 4, 4)
    with pytest.raises(OutputError, match="channels"):
        write_video(tmp_path / "a.mp4", [np.zeros((4, 4, 4), np.uint8)])


def test_without_ffmpeg_a_video_is_a_gif(tmp_path, monkeypatch):
    monkeypatch.setattr(video, "_has_ffmpeg", lambda: False)
    assert write_video(tmp_path / "a.mp4", frames(2)) == tmp_path / "a.gif"


def test_progress_counts_frames_and_speed(tmp_path):
    seen = []
    write_video(tmp_path / "frames", frames(4), on_frame=lambda *told: seen.append(told))
    assert [count for count, _ in seen] == [1, 2, 3, 4]
    assert all(speed > 0 for _, speed in seen)


def test_floats_are_rounded_and_clipped():
    found = to_bytes(np.array([-1, 0, 0.5, 1, 2, np.nan]))
    np.testing.assert_array_equal(found, [0, 0, 128, 255, 255, 0])


def test_encoding_overlaps_with_rendering(tmp_path):
    names = set()

    def watched():
        for frame in frames(3):
            names.update(thread.name for thread in threading.enumerate())
            yield frame

    write_video(tmp_path / "a.gif", watched())
    assert "encoder" in names
    assert all(thread.name != "encoder" for thread in threading.enumerate())


def failing():
    yield from frames(2)
    raise KeyboardInterrupt


@pytest.mark.parametrize("name", ["a.mp4", "a.gif", "frames"])
def test_an_interrupt_leaves_what_was_there(tmp_path, name):
    write_video(tmp_path / name, frames(4))
    before = sorted(file.name for file in tmp_path.rglob("*"))
    with pytest.raises(KeyboardInterrupt):
        write_video(tmp_path / name, failing())
    assert sorted(file.name for file in tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("name", "pictures", "found"),
    [
        ("a.mp4", [], "no frames"),
        ("frames", [], "no frames"),
        ("a.avi2", [np.zeros((4, 4, 3))], "expected .*mp4"),
        ("a.gif", [np.zeros((4, 4, 3)), np.zeros((5, 4, 3))], "shape"),
        ("a.gif", [np.zeros((4, 4))], "shape"),
        ("none/a.gif", [np.zeros((4, 4, 3))], "folder does not exist"),
        ("none/a.mp4", [np.zeros((4, 4, 3))], "folder does not exist"),
    ],
)
def test_what_cant_be_written_is_said(tmp_path, name, pictures, found):
    with pytest.raises(OutputError, match=found):
        write_video(tmp_path / name, pictures)
    assert not list(tmp_path.iterdir())


def test_a_failing_encoder_is_heard(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(imageio, "imwrite", full)
    with pytest.raises(OutputError, match="No space left"):
        write_video(tmp_path / "frames", frames(30))
    with pytest.raises(OutputError, match="No space left"):
        write_image(tmp_path / "a.png", np.zeros((4, 4, 3)))
    assert not list(tmp_path.iterdir())


def test_a_transparent_picture_keeps_its_colours(tmp_path):
    rgb = np.full((3, 5, 3), [0.5, 0.25, 0.0])
    alpha = np.full((3, 5), 0.5)
    alpha[0], rgb[0] = 0, 0
    write_image(tmp_path / "a.png", rgb, alpha)
    found = imageio.imread(tmp_path / "a.png")
    np.testing.assert_array_equal(found[1, 0], [255, 128, 0, 128])
    np.testing.assert_array_equal(found[0, 0], [0, 0, 0, 0])


def test_an_unknown_picture_format_is_refused(tmp_path):
    with pytest.raises(OutputError, match=r"a\.xyz"):
        write_image(tmp_path / "a.xyz", np.zeros((4, 4, 3)))
    assert not list(tmp_path.iterdir())
