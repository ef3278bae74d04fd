"""Where users got stuck once."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
from outcomes import failed
from PIL import Image

from splatmorph.app import run

Run = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize("command", [("streamlines",), ("eval",), ("export",)])
def test_one_splat_where_a_run_is_needed_says_what_can_be_done(
    pair: tuple[Path, Path], cli: Run, command: tuple[str, ...]
) -> None:
    failed(cli(*command, "a.ply"), "a.ply is a file", "run directory", "fit two splats first")


def test_a_sheet_of_one_splat_shows_its_views(pair: tuple[Path, Path], cli: Run) -> None:
    assert cli("render", "a.ply", "--sheet", "--size", "32x32")[0] == 0
    with Image.open("a-sheet.png") as sheet:
        assert sheet.height > 3 * 32
        assert sheet.width < 2 * 32
    failed(cli("render", "a.ply", "--sheet", "--t", "0.5", "-w"), "no t")


def test_a_sheet_of_an_average_shows_its_views(pair: tuple[Path, Path], cli: Run) -> None:
    assert cli("fit", *pair, "--mean")[0] == 0
    assert cli("render", "a-b-mean.run", "--sheet", "--size", "32x32")[0] == 0
    assert Path("a-b-mean-sheet.png").is_file()


def test_help_lists_the_ways_time_runs(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["render", "--help"]) == 0
    assert "linear (the default), smooth or smoother" in " ".join(
        capsys.readouterr().out.replace("│", " ").split()
    )


def test_the_page_that_a_fit_offers_is_written(pair: tuple[Path, Path], cli: Run) -> None:
    out = cli("fit", *pair)[1]
    (line,) = (line for line in out.splitlines() if "splatmorph view" in line)
    assert cli(*shlex.split(line.split("   ")[0])[1:])[0] == 0
    assert Path("a-b.html").is_file()


def test_a_bug_report_names_versions(cli: Run) -> None:
    code, out, _ = cli("--version", "--verbose")
    assert code == 0
    assert all(word in out for word in ("splatmorph ", "Python ", "torch ", "CPU cores"))


@pytest.mark.parametrize(
    "words",
    [
        ("fit", "--flow", "nosuch"),
        ("fit", "--field", "nosuch"),
        ("fit", "--method", "nosuch"),
        ("fit", "--energy", "nosuch"),
        ("fit", "--device", "nosuch"),
        ("view", "--blend", "nosuch", "-o", "a-b.html"),
        ("render", "--ease", "nosuch", "--t", "0.5", "-o", "a-b.html"),
    ],
)
def test_what_is_there_already_hides_no_wrong_option(
    fitted: Path, cli: Run, words: tuple[str, ...]
) -> None:
    Path("a-b.html").touch()
    inputs = ("a.ply", "b.ply") if words[0] == "fit" else (fitted,)
    code, _, err = cli(words[0], *inputs, *words[1:])
    assert code in (1, 2)
    assert "nosuch" in err
    assert "already" not in err


def test_a_run_that_is_there_is_seen_before_anything_is_looked_for(
    fitted: Path, cli: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("splatmorph.runs.request.find", lambda *_: pytest.fail("it looks"))
    failed(cli("fit", "a.ply", "b.ply"), "a-b.run is a finished run", "give -w")
