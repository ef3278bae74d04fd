"""``splatmorph bake``: what is written, what is said, what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from splatmorph import io
from splatmorph.app import run
from splatmorph.avatars import load_avatar
from splatmorph.landmarks import Landmarks


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_one_frame_with_its_landmarks(
    anna: Path, flame_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["bake", str(anna), "--frame", "2", "--flame", str(flame_folder)]
    assert run(arguments) == 0
    said = capsys.readouterr().out
    assert "anna.ply: 500 splats, posed frame 2 of its track" in said
    wanted = load_avatar(anna, frame=2, flame=flame_folder)
    written = io.read(tmp_path / "anna.ply")
    torch.testing.assert_close(written.means, wanted.gaussians.means, rtol=0, atol=0)
    torch.testing.assert_close(written.sh, wanted.gaussians.sh, rtol=0, atol=0)
    assert not written.extras
    beside = Landmarks.beside(tmp_path / "anna.ply")
    assert beside is not None
    assert Landmarks.read(beside).names == wanted.landmarks.names
    assert run(arguments) == 1
    assert "already there" in capsys.readouterr().err
    assert run([*arguments, "-w", "--landmarks-set", "dense", "--landmarks-count", "40"]) == 0
    assert len(Landmarks.read(beside)) == 40


def test_a_whole_track(anna: Path, ben: Path, flame_folder: Path, tmp_path: Path) -> None:
    arguments = ["bake", str(ben), "--track", "--flame", str(flame_folder)]
    assert run([*arguments, "--pose-from", str(anna), "-o", "out"]) == 0
    index = json.loads((tmp_path / "out" / "frames.json").read_text())
    assert [row["file"] for row in index["frames"]] == [f"frame_{i:04d}.ply" for i in range(4)]
    wanted = load_avatar(ben, pose=anna, frame=3, flame=flame_folder).gaussians
    last = io.read(tmp_path / "out" / "frame_0003.ply")
    torch.testing.assert_close(last.means, wanted.means, rtol=0, atol=0)
    assert run([*arguments, "-o", "out"]) == 1


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ([], "flame.is.tue.mpg.de"),
        (["--frame", "1", "--track"], "give one of the two"),
        (["--landmarks-set", "71"], "flame.is.tue.mpg.de"),
    ],
)
def test_refusals_are_one_line_and_leave_nothing(
    anna: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], words: str
) -> None:
    assert run(["bake", str(anna), *more]) == 1
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_mesh_has_no_track(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["bake", str(shared_data / "avatars" / "james"), "--track"]) == 1
    assert "james has no track: give one by --pose-from" in capsys.readouterr().err
