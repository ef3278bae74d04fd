"""`splatmorph export`: every format, whole frames, and ends that are the inputs."""

from __future__ import annotations

import errno
import json
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import pytest
import torch
from numpy.typing import NDArray
from outcomes import failed

from splatmorph import io
from splatmorph.gaussians import Gaussians
from splatmorph.io import elements
from splatmorph.io.axes import turn_between, upright
from splatmorph.io.usd import read_usd
from splatmorph.landmarks import Landmarks

MakeGaussians = Callable[..., Gaussians]
Run = Callable[..., tuple[int, str, str]]
pytestmark = pytest.mark.usefixtures("few_views")


def test_the_extension_of_out_says_one_file_or_a_folder(fitted: Path, cli: Run) -> None:
    out = cli("export", fitted, "--t", "0.5", "-o", "half.spz")[1]
    assert "wrote half.spz; lossy" in out
    assert len(io.read("half.spz")) <= 350
    failed(cli("export", fitted, "--t", "0.5", "-o", "half.spz"), "already there")
    assert cli("export", fitted, "--t", "0", "-o", "start.ply")[0] == 0
    assert torch.equal(io.read("start.ply").means, io.read("a.ply").means)
    # Names of folders may have dots.
    assert cli("export", fitted, "--t", "0.5", "-o", "v1.2")[0] == 0
    assert Path("v1.2/morph_0000.ply").is_file()


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (("-o", "x.spz"), ("one file for 5 times", "--t 0.5")),
        (("-o", "x.spz", "--t", "0,1"), ("one file for 2 times",)),
        (("-o", "x.foo"), ("extension", ".ply")),
        (("-o", "x.mp4", "--t", "0.5"), ("extension", ".ply")),
        (("-o", "x.spz", "--t", "0.5", "--format", "ply"), ("different formats",)),
    ],
)
def test_an_out_that_cannot_be_is_refused(
    fitted: Path, cli: Run, asked: tuple[str, ...], words: tuple[str, ...]
) -> None:
    failed(cli("export", fitted, *asked), *words)
    assert not Path(asked[1]).exists()


def test_the_whole_morph_is_one_usd_file(fitted: Path, cli: Run) -> None:
    pytest.importorskip("pxr", reason="usd-core is not installed")
    out = cli("export", fitted, "-o", "morph.usdc", "--frames", 5, "--seconds", 2, "--fps", 24)[1]
    assert "5 samples over 2 s" in out
    assert "as 48 .ply files" in out
    for t, end in ((0, "a.ply"), (48, "b.ply")):
        frame = read_usd("morph.usdc", time=t)
        assert len(frame) == 350
        shown = frame.select(frame.opacities > 1e-4)
        wanted = io.read(end)
        assert set(map(tuple, shown.means.tolist())) <= set(map(tuple, wanted.means.tolist()))
    failed(cli("export", fitted, "-o", "morph.usdc"), "already there")
    assert "lossy" in cli("export", fitted, "-o", "half.usda", "--t", "0.5")[1]


def test_axes_turn_splats_and_their_landmarks(fitted: Path, cli: Run) -> None:
    plain = cli("export", fitted, "--t", "0", "-o", "plain.ply")[1]
    assert "landmarks" not in plain
    for axes, up in (("y-down", "-y"), ("z-up", "z")):
        out = cli("export", fitted, "--t", "0", "--axes", axes, "-o", f"{axes}.ply")[1]
        assert f"{axes}.landmarks.json, turned along" in out
        turned = io.read(f"{axes}.ply")
        assert turned.up == up
        assert torch.equal(turned.means, upright(io.read("a.ply"), up).means)
        marks, before = (Landmarks.read(f"{name}.landmarks.json") for name in (axes, "a"))
        assert marks.names == before.names
        assert torch.allclose(marks.points, turn_between("y", up)(before.points))
    # What has y up by definition is turned without being asked, from what is known to stand else.
    for end in "ab":
        splats = io.read(f"{end}.ply")
        io.write(f"{end}.ply", upright(splats, "-y"), [])
        marks = Landmarks.read(f"{end}.landmarks.json")
        Landmarks(turn_between("y", "-y")(marks.points), marks.names).write(f"{end}.landmarks.json")
    assert cli("fit", "a.ply", "b.ply", "-o", "down.run")[0] == 0
    assert "landmarks" in cli("export", "down.run", "--t", "0.5", "-o", "half.glb")[1]
    assert cli("inspect", "half.glb")[0] == 0
    assert "180°" in cli("export", "down.run", "--t", "0.5", "-o", "half.spz")[1]


def test_exported_ends_are_the_inputs_bit_for_bit(fitted: Path, cli: Run) -> None:
    assert cli("export", fitted, "--frames", 3, "-o", "out")[0] == 0
    for name, source in (("morph_0000.ply", "a.ply"), ("morph_0002.ply", "b.ply")):
        frame, original = io.read(f"out/{name}"), io.read(source)
        for field in ("means", "quats", "log_scales", "opacity_logits", "sh"):
            assert torch.equal(getattr(frame, field), getattr(original, field))
    index = json.loads(Path("out/frames.json").read_text())
    assert [frame["t"] for frame in index["frames"]] == [0, 0.5, 1]
    assert index["splats"] == ["a", "b"]
    assert "splatmorph t=0.5 source=a target=b" in Path("out/morph_0001.ply").read_bytes()[
        :300
    ].decode("latin1")
    assert sorted(p.name for p in Path("out").iterdir()) == [
        "frames.json",
        "morph_0000.ply",
        "morph_0001.ply",
        "morph_0002.ply",
    ]


@pytest.mark.parametrize("kind", ["compressed.ply", "spz", "splat"])
def test_small_formats_go_all_the_way(fitted: Path, cli: Run, kind: str) -> None:
    code, out, _ = cli("export", fitted, "--frames", 3, "-o", "out", "--format", kind)
    assert code == 0
    (line,) = (line for line in out.splitlines() if "lossy" in line)
    rows = json.loads(Path("out/frames.json").read_text())["frames"]
    assert [row["file"] for row in rows] == [f"morph_000{i}.{kind}" for i in range(3)]
    moved = [
        float((io.read(f"out/{row['file']}").means - io.read(end).means).norm(dim=1).max())
        for row, end in zip(rows[::2], ("a.ply", "b.ply"), strict=True)
    ]
    assert moved == pytest.approx([rows[0]["moved"], rows[2]["moved"]], abs=1e-9)
    assert max(moved) < 2e-3
    most = max(row["moved"] for row in rows)
    assert (f"up to {most:.2g}" if most else "centers kept") in line
    # Another format takes the place of the frames, and does not mix with them.
    failed(cli("export", fitted, "--frames", 3, "-o", "out"), "holds frames already")
    assert cli("export", fitted, "--frames", 3, "-o", "out", "-w")[0] == 0
    assert len(list(Path("out").iterdir())) == 4

    # What was written is an input, with the landmarks of its stem.
    for end, name in (("a", "c"), ("b", "d")):
        io.write(f"{name}.{kind}", io.read(f"{end}.ply"))
        Path(f"{end}.landmarks.json").rename(f"{name}.landmarks.json")
    assert "20, named" in cli("inspect", f"c.{kind}")[1]
    assert cli("fit", f"c.{kind}", f"d.{kind}")[0] == 0
    assert cli("render", "c-d.run", "-o", "x.png", "--size", "32x32")[0] == 0
    assert cli("render", f"c.{kind}", "-o", "y.png", "--size", "32x32")[0] == 0


def test_an_average_is_written_in_any_format(
    pair: tuple[Path, Path], cli: Run, make_gaussians: MakeGaussians
) -> None:
    assert cli("fit", *pair, "--mean")[0] == 0
    assert "lossy" in cli("export", "a-b-mean.run", "--format", "spz")[1]
    assert len(io.read("a-b-mean.spz")) == 350
    assert cli("export", "a-b-mean.run", "-o", "x.splat")[0] == 0
    failed(cli("export", "a-b-mean.run", "-o", "x.ply", "--format", "spz"), "different formats")


def test_invisible_splats_are_pruned_between_the_ends_only(fitted: Path, cli: Run) -> None:
    out = cli("export", fitted, "--t", "0,0.5,1", "-o", "out")[1]
    rows = json.loads(Path("out/frames.json").read_text())["frames"]
    assert rows[0]["pruned"] == rows[2]["pruned"] == 0 < rows[1]["pruned"]
    assert f"left out {rows[1]['pruned']}" in out
    cli("export", fitted, "--t", "0.5", "-o", "all", "--no-prune")
    assert len(io.read("all/morph_0000.ply")) == 350


def test_every_splat_can_stay_in_every_frame(fitted: Path, cli: Run) -> None:
    assert cli("export", fitted, "--stable-count", "--frames", 3, "-o", "out")[0] == 0
    assert [len(io.read(file)) for file in sorted(Path("out").glob("*.ply"))] == [350] * 3


def test_an_export_that_was_killed_goes_on(
    fitted: Path, cli: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    cli("export", fitted, "--frames", 6, "-o", "whole")
    genuine, written = io.write, []

    def killed(path: Path, *rest: object) -> None:
        if len(written) == 3:
            raise KeyboardInterrupt
        written.append(path)
        genuine(path, *rest)

    monkeypatch.setattr(io, "write", killed)
    assert cli("export", fitted, "--frames", 6, "-o", "out")[0] == 130
    assert not Path("out/frames.json").exists()
    monkeypatch.setattr(io, "write", genuine)
    code, out, _ = cli("export", fitted, "--frames", 6, "-o", "out")
    assert code == 0
    assert "3 frames were there" in out
    for file in Path("whole").iterdir():
        assert file.read_bytes() == (Path("out") / file.name).read_bytes()
    # Another export doesn't mix its frames with those of an unfinished one.
    monkeypatch.setattr(io, "write", killed)
    written.clear()
    cli("export", fitted, "--frames", 6, "-o", "out2")
    monkeypatch.setattr(io, "write", genuine)
    failed(cli("export", fitted, "--frames", 5, "-o", "out2"), "holds frames already")


def test_a_full_disk_leaves_whole_frames_that_the_next_export_keeps(
    fitted: Path, cli: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = count(1)

    def full(records: NDArray[Any]) -> bytes:
        # The header is written by then.
        if next(frames) == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        return records.tobytes()

    monkeypatch.setattr(elements, "_bytes", full)
    failed(cli("export", fitted, "-o", "out"), "morph_0002.ply: the disk is full")
    assert sorted(file.name for file in Path("out").glob("*.ply")) == [
        "morph_0000.ply",
        "morph_0001.ply",
    ]
    assert "2 frames were there" in cli("export", fitted, "-o", "out")[1]
    assert len(io.read("out/morph_0004.ply")) == 150
