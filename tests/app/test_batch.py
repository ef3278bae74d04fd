"""``splatmorph batch``: a table in, a folder of runs and a summary out, whatever goes wrong."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
import torch
from PIL import Image

from splatmorph import io
from splatmorph.app import console, run
from splatmorph.gaussians import Gaussians
from splatmorph.landmarks import Landmarks
from splatmorph.runs.run import open_run

MakeGaussians = Callable[..., Gaussians]
Batch = Callable[..., tuple[int, str, str]]


@pytest.fixture
def batch(cli: Batch) -> Batch:
    """``batch(table, ...)`` → exit code, stdout, stderr."""
    return partial(cli, "batch")


@pytest.fixture
def splats(tmp_path: Path, make_gaussians: MakeGaussians, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three splats with landmarks beside them, away from the current folder."""
    folder = tmp_path / "data"
    folder.mkdir()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    points = torch.rand(12, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(5))
    for i, name in enumerate("abc"):
        io.write(folder / f"{name}.ply", make_gaussians(60, 0, seed=i))
        moved = points * (1 + 0.1 * i) + 0.05 * i * points.roll(1, 1) ** 2
        Landmarks(moved, tuple(f"p{k}" for k in range(12))).write(folder / f"{name}.landmarks.json")
    return folder


def table(folder: Path, *lines: str, columns: str = "source,target") -> Path:
    path = folder / "pairs.csv"
    path.write_text("\n".join([columns, *lines]) + "\n", encoding="utf-8")
    return path


def summary(path: str) -> list[dict[str, str]]:
    with Path(path).open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_each_pair_becomes_a_run(splats: Path, batch: Batch) -> None:
    code, out, err = batch(table(splats, "a.ply,b.ply", "", "b.ply , c.ply"))
    assert code == 0
    assert "1/2 a-b" in err
    assert "wrote pairs-runs/summary.csv" in out
    rows = summary("pairs-runs/summary.csv")
    assert [(row["name"], row["status"]) for row in rows] == [("a-b", "fitted"), ("b-c", "fitted")]
    for row in rows:
        assert row["name"] in out
        report = open_run(f"pairs-runs/{row['name']}.run").legs[0].report
        assert float(row["det_min"]) == report["det_min"]
        assert float(row["rms_error"]) == (3 * report["mse_world"]) ** 0.5
        assert float(row["worst_error"]) == report["errors"][row["worst_landmark"]]
    assert run(["render", "pairs-runs/a-b.run", "-o", "x.png", "--size", "16x16"]) == 0


def test_a_wrong_pair_does_not_stop_the_others(splats: Path, batch: Batch) -> None:
    (splats / "c.landmarks.json").unlink()
    pairs = table(splats, "none.ply,a.ply", "a.ply,c.ply", "a.ply,b.ply")
    code, out, err = batch(pairs, "--no-auto")
    assert code == 1
    assert "error: none-a: " in err
    assert "error: a-c: " in err
    assert "2 of 3 pairs failed (none-a, a-c)" in err.splitlines()[-1]
    assert [row["status"] for row in summary("pairs-runs/summary.csv")] == [
        "failed",
        "failed",
        "fitted",
    ]
    assert "does not exist" in summary("pairs-runs/summary.csv")[0]["message"]
    assert "failed" in out
    assert "Traceback" not in err


def test_what_is_done_is_kept_and_what_has_changed_needs_leave(splats: Path, batch: Batch) -> None:
    pairs = table(splats, "a.ply,b.ply", "a.ply,c.ply")
    batch(pairs, "-o", "out")
    weights = Path("out/a-b.run/flow.safetensors")
    before = weights.stat().st_mtime_ns
    batch(pairs, "-o", "out")
    assert [row["status"] for row in summary("out/summary.csv")] == ["kept", "kept"]
    stored = json.loads((splats / "c.landmarks.json").read_text())
    stored["points"]["p0"][0] += 0.01
    (splats / "c.landmarks.json").write_text(json.dumps(stored))
    code, _, err = batch(pairs, "-o", "out")
    assert code == 1
    assert "a-c.run is a run of other inputs or options: give -w" in err
    assert batch(pairs, "-o", "out", "-w")[0] == 0
    assert [row["status"] for row in summary("out/summary.csv")] == ["kept", "fitted"]
    assert weights.stat().st_mtime_ns == before
    assert batch(pairs, "-o", "out", "--smoothing", "1e-3")[0] == 1
    # A damaged run is fitted anew.
    weights.write_bytes(b"")
    assert batch(pairs, "-o", "out")[0] == 1
    assert batch(pairs, "-o", "out", "-w")[0] == 0


@pytest.mark.parametrize("at", [20, 40])
def test_an_interrupted_batch_goes_on_to_the_same_bits(
    splats: Path, batch: Batch, monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    words = (table(splats, "a.ply,b.ply", "b.ply,c.ply"), "--field", "siren", "--steps", 40)
    whole = ("fit", splats / "b.ply", splats / "c.ply", *words[1:], "-o", "whole.run")
    assert run([str(word) for word in whole]) == 0
    begun = []

    @contextlib.contextmanager
    def impatient(what: str) -> Iterator[Callable[[int, int, str], None]]:
        begun.append(what)

        def update(done: int, total: int, note: str = "") -> None:
            if len(begun) == 2 and done >= at:
                raise KeyboardInterrupt

        yield update

    with monkeypatch.context() as patched:
        patched.setattr(console, "progress", impatient)
        assert batch(*words, "-o", "cut")[0] == 130
    assert [row["name"] for row in summary("cut/summary.csv")] == ["a-b"]
    assert batch(*words, "-o", "cut")[0] == 0
    assert [row["status"] for row in summary("cut/summary.csv")] == ["kept", "fitted"]
    ends = [open_run(run).legs[0].flow.state_dict() for run in ("whole.run", "cut/b-c.run")]
    for name, value in ends[0].items():
        assert torch.equal(ends[1][name], value), name


def test_a_batch_goes_on_with_what_a_kill_left_of_a_run(splats: Path, batch: Batch) -> None:
    pairs = table(splats, "a.ply,b.ply")
    assert batch(pairs)[0] in (0, 3)
    (run,) = Path().rglob("morph.json")
    whole = run.with_name("flow.safetensors").read_bytes()
    run.unlink()
    assert batch(pairs)[0] in (0, 3)
    assert run.is_file()
    assert run.with_name("flow.safetensors").read_bytes() == whole


def test_names_and_landmarks_of_the_table(splats: Path, batch: Batch) -> None:
    (splats / "b.landmarks.json").rename(splats / "marks.json")
    pairs = table(
        splats,
        "first,a.ply,b.ply,marks.json",
        "second,a.ply,c.ply,",
        "third,a.ply,c.ply",
        columns="name,source,target,target_landmarks",
    )
    code, out, _ = batch(pairs, "--json")
    assert code == 0
    rows = json.loads(out)["pairs"]
    assert [row["name"] for row in rows] == ["first", "second", "third"]
    assert all(row["landmarks"] == 12 for row in rows)
    assert batch(pairs, "-q") == (0, "", "")


@pytest.mark.parametrize(
    ("columns", "lines", "words"),
    [
        ("source,target", [], "holds no pairs"),
        ("", [], "begins with nothing"),
        ("a,b", ["a.ply,b.ply"], "expected the columns source,target"),
        ("source,target,landmark", ["a.ply,b.ply,"], "expected the columns"),
        ("source,source,target", ["a.ply,a.ply,b.ply"], "expected the columns"),
        ("source,target", ["a.ply,b.ply,c.ply"], "more cells than columns in line 2"),
        ("source,target", ["a.ply,b.ply", "a.ply,"], "no target in line 3"),
        ("source,target", ["a.ply,b.ply", "a.ply,b.ply"], "the run a-b in lines 2 and 3"),
        ("source,target,name", ["a.ply,b.ply,x/y"], "the run 'x/y' in line 2"),
    ],
)
def test_tables_that_are_wrong(
    splats: Path, batch: Batch, columns: str, lines: list[str], words: str
) -> None:
    code, _, err = batch(table(splats, *lines, columns=columns))
    assert code == 1
    assert words in err
    assert err.count("\n") == 1
    assert not list(Path().iterdir())


def test_files_that_are_no_tables(splats: Path, batch: Batch) -> None:
    assert "No such file" in batch(splats / "no.csv")[2]
    assert "is no text" in batch(splats / "a.ply")[2]


def test_a_pair_that_misses_its_landmarks_by_far_is_told_and_kept(
    splats: Path, batch: Batch
) -> None:
    marks = Landmarks.read(splats / "b.landmarks.json")
    shuffled = torch.randperm(12, generator=torch.Generator().manual_seed(3))
    Landmarks(marks.points[shuffled], marks.names).write(splats / "b.landmarks.json")
    code, _, err = batch(table(splats, "a.ply,b.ply", "a.ply,c.ply"), "-o", "runs")
    assert code == console.MISSED
    assert "a-b misses many of its landmarks by far" in err
    assert [row["status"] for row in summary("runs/summary.csv")] == ["missed", "fitted"]
    assert open_run("runs/a-b.run").legs[0].report["missed"]


@pytest.fixture
def pictures(splats: Path) -> Path:
    """Two pictures with landmarks beside the splats."""
    draw = torch.Generator().manual_seed(2)
    for name in "de":
        pixels = (torch.rand(24, 24, 3, generator=draw) * 255).to(torch.uint8)
        Image.fromarray(pixels.numpy()).save(splats / f"{name}.png")
        points = torch.rand(9, 2, generator=draw) * 0.1 + torch.cartesian_prod(
            *[torch.tensor([-0.5, 0, 0.5])] * 2
        )
        Landmarks(points.double()).write(splats / f"{name}.landmarks.json")
    return splats


MIXED = ["splats,a.ply,b.ply", "pictures,d.png,e.png", "pictures,d.png,none.png", ",b.ply,c.ply"]
ASKED = ("--render", "--t 0.5 -o .png --size 32x32", "--export", "--frames 2", "--eval", "")


def outputs(folder: str) -> dict[str, bytes]:
    """What a batch made that doesn't hold times."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(Path(folder).rglob("*"))
        if path.suffix in (".png", ".ply", ".safetensors", ".jpg")
    }


def test_rows_are_fitted_rendered_exported_and_measured(pictures: Path, batch: Batch) -> None:
    pairs = table(pictures, *MIXED, columns="kind,source,target")
    words = (*ASKED, "--image", "--size 24x24 --convention unit-xy", "-o", "out")
    code, _, err = batch(pairs, *words)
    assert code == 1
    assert err.splitlines()[-1].startswith("error: 1 of 4 pairs failed (d-none)")
    assert re.search(r"error: d-none: can't read \S+none.png: No such file", err)
    rows = {row["name"]: row for row in summary("out/summary.csv")}
    assert rows["a-b"]["files"] == "a-b.run; a-b.png; a-b-frames; a-b-eval.json"
    assert rows["d-e"]["files"] == "d-e.png; d-e.report.json"
    for row in (rows["a-b"], rows["d-e"]):
        assert all(Path("out", file).exists() for file in row["files"].split("; "))
        assert Path("out/thumbnails", f"{row['name']}.jpg").is_file()
    page = Path("out/summary.html").read_text()
    assert "thumbnails/d-e.jpg" in page
    assert "http" not in page
    before = {path: path.stat().st_mtime_ns for path in Path("out").rglob("*.p*")}
    batch(pairs, *words)
    assert [row["status"] for row in summary("out/summary.csv")] == ["kept"] * 2 + [
        "failed",
        "kept",
    ]
    assert before == {path: path.stat().st_mtime_ns for path in Path("out").rglob("*.p*")}
    changed = ("--render", "--t 0.4 -o .png --size 32x32")
    assert "a-b.png is of other inputs or options" in batch(pairs, *changed, "-o", "out")[2]
    assert "other inputs" not in batch(pairs, *changed, "-o", "out", "-w")[2]


def test_workers_make_the_same_bits_though_one_is_killed(
    pictures: Path, batch: Batch, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    import psutil

    note, killed = console.note, []

    def deadly(message: str) -> None:
        note(message)
        workers = [one for one in psutil.Process().children() if "spawn_main" in str(one.cmdline())]
        if message.startswith("1/4 ") and workers:
            workers[0].kill()
            killed.append(workers[0])

    monkeypatch.setattr(console, "note", deadly)
    pairs = table(pictures, *MIXED, columns="kind,source,target")
    words = (*ASKED[:2], "--image", "--size 24x24 --convention unit-xy")
    batch(pairs, *words, "-o", "one")
    before = dict(os.environ)
    code, out, err = batch(pairs, *words, "-o", "two", "--workers", 2, "--json")
    assert code == 1
    assert dict(os.environ) == before
    assert "4/4 " in err
    assert "error: d-none: " in err
    assert [row["name"] for row in json.loads(out)["pairs"]] == ["a-b", "d-e", "d-none", "b-c"]
    assert len(killed) == 1
    assert outputs("one") == outputs("two")
    assert len(outputs("one")) == 8


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--render", "--nonsense 1"), 1, "--render takes the options of that command"),
        (("--render", "-o x/y.png"), 1, "expected what follows the name of each row's output"),
        (("--image", "--frames 0"), 2, "--frames is 0"),
        (("--export", "'"), 1, "No closing quotation"),
        (("--workers", "0"), 2, "--workers is 0"),
    ],
)
def test_steps_are_refused_before_any_work(
    splats: Path, batch: Batch, words: tuple[str, str], code: int, said: str
) -> None:
    found, _, err = batch(table(splats, "a.ply,b.ply"), *words)
    assert (found, said in err) == (code, True), err
    assert not Path("pairs-runs").exists()
