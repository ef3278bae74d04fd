"""The command line as a user meets it: files in, files out, one line where something is wrong."""

from __future__ import annotations

import contextlib
import json
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from outcomes import failed
from PIL import Image

from splatmorph import io
from splatmorph.app import console
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.quaternions import matrices_from_axis_angles
from splatmorph.geometry.similarity import Similarity
from splatmorph.images.quality import psnr
from splatmorph.landmarks import Landmarks
from splatmorph.runs.run import open_run

MakeGaussians = Callable[..., Gaussians]
Run = Callable[..., tuple[int, str, str]]
pytestmark = pytest.mark.usefixtures("few_views")


# The main job -------------------------------------------------------------------------------


def test_fit_says_what_was_met_and_what_to_type_next(pair: tuple[Path, Path], cli: Run) -> None:
    code, out, _ = cli("fit", *pair)
    assert code == 0
    for words in (
        "20 landmarks",
        "before",
        "after",
        "surfaces at half-time",
        "flow laws",
        "wrote a-b.run",
    ):
        assert words in out
    # The commands that it prints work as they stand.
    (line,) = (line for line in out.splitlines() if "splatmorph export" in line)
    command = shlex.split(line.split("   ")[0])[1:]
    assert cli(*command)[0] == 0
    report = json.loads(Path("a-b.run/report.json").read_text())["legs"][0]
    assert report["mse"] < 1e-6 < report["mse_before"]


def test_what_to_type_next_is_quoted_for_the_shell(pair: tuple[Path, Path], cli: Run) -> None:
    out = cli("fit", *pair, "-o", "it's (1).run")[1]
    lines = [line for line in out.splitlines() if line.startswith("  splatmorph")]
    assert [shlex.split(line)[2] for line in lines] == ["it's (1).run"] * 3


def test_render_makes_a_video_and_pictures(fitted: Path, cli: Run) -> None:
    small = ("--size", "48x32", "--frames", 4)
    assert cli("render", fitted, *small)[0] == 0
    assert Path("a-b.mp4").stat().st_size > 500
    assert cli("render", fitted, *small, "--t", "0.5", "-o", "x.gif")[0] == 0
    with Image.open("x.gif") as picture:
        assert picture.size == (48, 32)
        assert picture.n_frames == 4
    assert cli("render", fitted, "--size", "40x40", "--t", "0", "-o", "x.png")[0] == 0
    assert cli("render", "a.ply", "--size", "40x40", "-o", "y.png")[0] == 0
    x, y = (np.asarray(Image.open(name)).astype(int) for name in ("x.png", "y.png"))
    assert x.shape == y.shape == (40, 40, 3)
    assert x.std() > 10
    transparent = ("--background", "transparent", "-o", "z.png")
    assert cli("render", "a.ply", "--size", "40x40", *transparent)[0] == 0
    assert np.asarray(Image.open("z.png")).shape == (40, 40, 4)


def test_inspect_describes_for_people_and_machines(pair: tuple[Path, Path], cli: Run) -> None:
    code, out, _ = cli("inspect", *pair)
    assert code == 0
    assert "200" in out
    assert "20, named" in out
    described = json.loads(cli("inspect", "a.ply", "--json")[1])["files"][0]
    assert described["splats"] == 200
    assert described["sh_degree"] == 1
    Path("bad.ply").write_text("nothing")
    failed(cli("inspect", "bad.ply", "-q"), "bad.ply")


def test_a_chain_visits_every_splat_bit_for_bit(
    pair: tuple[Path, Path], cli: Run, make_gaussians: MakeGaussians
) -> None:
    io.write("c.ply", make_gaussians(90, 0, seed=2))
    marks = Landmarks.read("a.landmarks.json")
    Landmarks(0.8 * marks.points, marks.names).write("c.landmarks.json")
    assert cli("fit", "a.ply", "b.ply", "c.ply")[0] == 0
    assert cli("export", "a-b-c.run", "--frames", 5, "-o", "out")[0] == 0
    for i, name in ((0, "a"), (2, "b"), (4, "c")):
        assert torch.equal(io.read(f"out/morph_{i:04}.ply").means, io.read(f"{name}.ply").means)
    header = Path("out/morph_0003.ply").read_bytes()[:300].decode("latin1")
    assert "t=1.5 source=b target=c" in header
    assert cli("render", "a-b-c.run", "--size", "32x32", "--frames", 3)[0] == 0
    assert "group" in cli("eval", "a-b-c.run")[1]
    assert cli("fit", "a.ply", "b.ply", "c.ply", "--mean")[0] == 0
    assert len(json.loads(cli("eval", "a-b-c-mean.run", "--json")[1])["legs"]) == 3
    assert cli("export", "a-b-c-mean.run")[0] == 0
    assert 0 < len(io.read("a-b-c-mean.ply")) <= 440
    assert cli("render", "a-b-c-mean.run", "--size", "32x32", "-o", "mean.png")[0] == 0
    for name in ("a-b-c.run", "a-b-c-mean.run"):
        assert cli("view", name, "-o", f"{name}.html")[0] == 0


def test_stretched_splats_are_split_where_asked(fitted: Path, cli: Run) -> None:
    asked = ("--split", 1.15, "--stable-count", "--frames", 3)
    assert cli("export", fitted, *asked, "-o", "out")[0] == 0
    first, middle, last = (len(io.read(file)) for file in sorted(Path("out").glob("*.ply")))
    assert first == middle == last > 350
    assert cli("render", fitted, "--split", 1.15, "--size", "32x32", "-o", "x.png")[0] == 0
    failed(cli("render", fitted, "--split", 0.5, "-o", "y.png"), "split is 0.5", code=2)


# Outputs that are there ---------------------------------------------------------------------


def test_nothing_is_overwritten_unasked(fitted: Path, cli: Run) -> None:
    before = Path("a-b.run/flow.safetensors").read_bytes()
    failed(cli("fit", "a.ply", "b.ply"), "a-b.run is a finished run", "-w")
    assert Path("a-b.run/flow.safetensors").read_bytes() == before
    assert cli("fit", "a.ply", "b.ply", "-w")[0] == 0
    Path("x.png").write_text("mine")
    failed(cli("render", fitted, "-o", "x.png"), "x.png is already there", "-w")
    assert Path("x.png").read_text() == "mine"
    assert cli("export", fitted, "--frames", 3, "-o", "out")[0] == 0
    failed(cli("export", fitted, "--frames", 2, "-o", "out"), "holds frames already", "-w")
    assert cli("export", fitted, "--frames", 2, "-o", "out", "-w")[0] == 0
    assert len(list(Path("out").glob("*.ply"))) == 2
    Path("folder").mkdir()
    Path("folder/mine.txt").touch()
    failed(cli("fit", "a.ply", "b.ply", "-o", "folder"), "folder is there already")


def test_an_interrupted_fit_keeps_the_best_and_goes_on_to_the_same_bits(
    pair: tuple[Path, Path], cli: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    training = ("fit", *pair, "--field", "siren", "--steps", 60)
    assert cli(*training, "-o", "whole.run")[0] == 0

    @contextlib.contextmanager
    def impatient(what: str) -> Iterator[Callable[[int, int, str], None]]:
        def update(done: int, total: int, note: str = "") -> None:
            if done >= 40:  # the state of step 20 is kept
                raise KeyboardInterrupt

        yield update

    with monkeypatch.context() as patched:
        patched.setattr(console, "progress", impatient)
        code, _, err = cli(*training, "-o", "cut.run")
    assert code == 130
    assert "interrupted: the best flow so far is kept" in err
    assert open_run("cut.run").legs[0].report["interrupted"]
    failed(cli(*training, "-o", "cut.run", "--seed", 1, "--resume"), "other inputs or options")
    assert cli(*training, "-o", "cut.run", "--resume")[0] == 0
    ends = [open_run(name).legs[0].flow.state_dict() for name in ("whole.run", "cut.run")]
    for name, value in ends[0].items():
        assert torch.equal(ends[1][name], value), name
    failed(cli(*training, "-o", "cut.run", "--resume"), "nothing is left to --resume")


# Bad input ----------------------------------------------------------------------------------


def test_usage_errors_exit_with_2(pair: tuple[Path, Path], cli: Run) -> None:
    failed(cli("fit", "a.ply"), code=2)
    failed(cli("nonsense"), code=2)
    failed(cli("render", "a.ply", "--size", "big"), "WIDTHxHEIGHT", code=2)
    failed(cli("render", "a.ply", "--background", "sky"), "no colour", code=2)
    failed(cli("export", "a.ply", "--t", "soon"), "no time", code=2)
    failed(cli("export", "a.ply", "--format", "obj"), "compressed.ply, glb", code=2)
    assert cli("--help")[0] == cli("--version")[0] == 0


def test_data_errors_are_one_line(pair: tuple[Path, Path], cli: Run) -> None:
    failed(cli("fit", "a.ply", "none.ply"), "none.ply does not exist")
    failed(cli("render", "a-b.run"), "a-b.run does not exist")
    failed(cli("export", "."), "no complete run")
    failed(cli("fit", "a.ply", "b.ply", "--flow", "magic"), "magic")
    failed(cli("render", "a.ply", "--frames", 0), "--frames is 0", code=2)
    failed(cli("render", "a.ply", "--up", "w"), "up")
    failed(cli("render", "a.ply", "-o", "no/x.png"), "no")
    failed(cli("fit", "a.ply", "b.ply", "-o", "a.ply/x.run"), "can't make the folder")
    failed(cli("fit", "a.ply", "b.ply", "-o", "a.ply"), "a.ply is a file")
    Path("b.landmarks.json").unlink()
    failed(cli("fit", "a.ply", "b.ply", "--no-auto"), "no landmarks", "b.landmarks.json", "nose")
    Landmarks(torch.rand(5, 3), tuple("vwxyz")).write("b.landmarks.json")
    failed(cli("fit", "a.ply", "b.ply"), "0 matched landmark pairs")
    Landmarks(1000 * torch.rand(5, 3), tuple("vwxyz")).write("b.landmarks.json")
    failed(cli("fit", "a.ply", "b.ply"), "far outside the splat b.ply")
    assert not list(Path().glob("*.run"))


def test_quiet_prints_errors_only(pair: tuple[Path, Path], cli: Run) -> None:
    assert cli("fit", *pair, "-q") == (0, "", "")
    failed(cli("fit", *pair, "-q"), "finished run")


def test_verbose_adds_the_traceback(pair: tuple[Path, Path], cli: Run) -> None:
    assert "Traceback" in cli("fit", "a.ply", "none.ply", "--verbose")[2]


# What is loaded -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "statement",
    ["import splatmorph", "from splatmorph.app import run; run(['--help'])"],
)
def test_heavy_packages_wait_until_they_are_needed(statement: str) -> None:
    heavy = ("torch", "warp", "pyvista", "vtk", "matplotlib", "cv2", "viser", "plyfile")
    code = f"import sys\n{statement}\nassert not set(sys.modules) & set({heavy}), sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_the_library_offers_what_it_says() -> None:
    import splatmorph as sm

    for name in sm.__all__:
        assert getattr(sm, name) is not None
    assert callable(sm.fit)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = sm.nothing


# Captures that share no frame --------------------------------------------------------------


def stand_apart(degrees: float, scale: float) -> Similarity:
    """Turn, scale and move b.ply and its landmarks."""
    axis = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    turn = matrices_from_axis_angles(torch.deg2rad(torch.tensor(degrees)) * axis)
    done = Similarity(turn, scale, torch.tensor([3.0, -2.0, 5.0]))
    io.write("b.ply", io.read("b.ply").moved(done))
    Landmarks.read("b.landmarks.json").moved(done).write("b.landmarks.json")
    return done


def test_a_target_that_stands_apart_looks_as_at_rest(pair: tuple[Path, Path], cli: Run) -> None:
    sheet = ("--sheet", "--t", "0,0.5,1", "--size", "64x64")
    assert cli("fit", *pair, "-o", "rest.run")[0] == 0
    assert cli("render", "rest.run", *sheet, "-o", "rest.png")[0] == 0
    stand_apart(150, 3)
    code, out, _ = cli("fit", *pair, "-o", "away.run")
    assert code == 0
    assert "about x" in out
    assert "times as large" in out
    assert cli("render", "away.run", *sheet, "-o", "away.png")[0] == 0
    rest, away = (torch.from_numpy(np.array(Image.open(f"{n}.png"))) for n in ("rest", "away"))
    assert psnr(rest / 255, away / 255) > 45
    assert cli("export", "away.run", "--frames", 2, "-o", "played")[0] == 0
    assert cli("export", "away.run", "--frames", 2, "--stay", "-o", "still")[0] == 0
    played, still = (io.read(f"{folder}/morph_0001.ply") for folder in ("played", "still"))
    assert torch.equal(played.means, io.read("b.ply").means)
    frame = open_run("away.run").legs[0].frame
    torch.testing.assert_close(still.means, frame.inverse()(played.means), atol=1e-5, rtol=0)


def test_other_units_are_named(pair: tuple[Path, Path], cli: Run) -> None:
    stand_apart(0, 1e-3)
    code, out, err = cli("fit", *pair)
    assert code == 0
    assert "the source is about 1000 times the target (mm against m?)" in out
    assert "misplaced" not in err


def test_landmarks_missed_by_far_exit_with_3_and_keep_the_run(
    pair: tuple[Path, Path], cli: Run
) -> None:
    marks = Landmarks.read("b.landmarks.json")
    shuffled = torch.randperm(20, generator=torch.Generator().manual_seed(3))
    Landmarks(marks.points[shuffled], marks.names).write("b.landmarks.json")
    code, _, err = cli("fit", *pair)
    assert code == console.MISSED == 3
    assert err.startswith("error: not met: ")
    assert open_run("a-b.run").legs[0].report["missed"]


def test_up_takes_a_minus_as_it_stands_and_else_what_the_file_says(
    pair: tuple[Path, Path], cli: Run
) -> None:
    io.write("z.ply", replace(io.read("a.ply"), up="z"))
    for options, name in (((), "said"), (("--up", "z"), "given"), (("--up", "-y"), "other")):
        words = ("render", "z.ply", *options, "--size", "48x48", "-o", f"{name}.png")
        assert cli(*words)[0] == 0
    said, given, other = (Path(f"{name}.png").read_bytes() for name in ("said", "given", "other"))
    assert said == given != other
    assert "z (its file says so)" in cli("inspect", "z.ply")[1]


def test_detail_that_single_precision_has_lost_is_told_wherever_a_splat_is_read(
    pair: tuple[Path, Path], cli: Run
) -> None:
    splats = io.read("a.ply")
    far = replace(splats, means=splats.means + torch.tensor([4.8e6, 5.4e7, 0.0]))
    io.write("far.ply", far)
    picture = ("--size", "32x32", "-o", "far.png")
    for words in (("render", "far.ply", *picture), ("landmarks", "far.ply", "none.ply")):
        err = cli(*words)[2]
        assert err.splitlines()[0].startswith("warning: far.ply holds its centers in single")
        assert "rounded to 4" in err
    assert cli("render", "a.ply", *picture, "-w")[2] == ""


def test_eval_scores_pairs_in_the_coordinates_of_the_files(
    pair: tuple[Path, Path], cli: Run
) -> None:
    away = torch.tensor([480000.0, 5400000.0, 100.0], dtype=torch.float64)
    rows = {}
    for name in "ab":
        splats = io.read(f"{name}.ply")
        io.write(f"{name}.ply", replace(splats, offset=tuple(away.tolist())))
        marks = Landmarks.read(f"{name}.landmarks.json")
        rows[name] = marks.points + away
        Landmarks(rows[name], marks.names).write(f"{name}.landmarks.json")
    np.savez("far.npz", source=rows["a"].numpy(), target=rows["b"].numpy())
    assert cli("fit", *pair)[0] == 0
    (leg,) = json.loads(cli("eval", "a-b.run", "--held-out", "far.npz", "--json")[1])["legs"]
    assert leg["held_out"]["mean"] < 0.5 * leg["held_out"]["mean_before"] < 1
