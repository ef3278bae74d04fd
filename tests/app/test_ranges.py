"""Every number on the command line is checked before any work."""

from __future__ import annotations

import pytest

from splatmorph.app import COMMANDS as ALL
from splatmorph.app import run
from splatmorph.app.ranges import RANGES

NOWHERE = ("nan", "inf", "-inf", "-1", "1e30", "99999999999999999999", "9" * 5000, "", "x")
COMMANDS = {
    ("fit", "a.ply", "b.ply"): ("smoothing", "steps", "seed", "landmarks-count", "frame"),
    ("render", "r.run"): ("frames", "fps", "split", "size"),
    ("export", "r.run"): ("frames", "split"),
    ("view", "r.run"): ("max-splats", "port"),
    ("bake", "anna"): ("frame", "landmarks-count"),
    ("image", "a.png", "b.png"): ("frames", "fps", "anchors", "smoothing", "seed", "max-pixels"),
    ("streamlines", "r.run"): ("seeds", "frames"),
}


@pytest.mark.parametrize("value", NOWHERE)
@pytest.mark.parametrize(
    ("command", "option"),
    [(command, name) for command, names in COMMANDS.items() for name in names],
)
def test_numbers_out_of_range_are_bad_usage(
    command: tuple[str, ...], option: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([*command, f"--{option}={value}"]) == 2
    said = capsys.readouterr()
    assert "bug" not in said.out + said.err


@pytest.mark.parametrize("value", ["nan", "inf", "1e30", "x", ""])
@pytest.mark.parametrize("option", ["t", "azimuth", "elevation", "orbit", "background"])
def test_numbers_that_may_be_negative(option: str, value: str) -> None:
    assert run(["render", "r.run", f"--{option}={value}"]) == 2


def test_pictures_that_fill_the_memory_are_bad_usage() -> None:
    assert run(["image", "a.png", "b.png", "--size", "100000x100000"]) == 2


def test_the_line_says_what_is_expected(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["render", "r.run", "--fps", "nan"]) == 2
    assert capsys.readouterr().err == "error: --fps is nan, expected 0.1 to 1000\n"


def test_ranges_are_in_order() -> None:
    assert list(RANGES) == sorted(RANGES)
    assert all(low < high for low, high in RANGES.values())


WITH_UP = ("pick", "render", "streamlines", "view")


@pytest.mark.parametrize("command", WITH_UP)
def test_a_minus_stands_as_it_is_typed(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    for axis in ("-y", "-z"):
        inputs = ["missing.run", "b.ply"][: 2 if command == "pick" else 1]
        assert run([command, *inputs, "--up", axis]) == 1
        assert "missing.run" in capsys.readouterr().err


def test_no_other_command_takes_an_axis(capsys: pytest.CaptureFixture[str]) -> None:
    for command in sorted(set(ALL) - set(WITH_UP)):
        assert run([command, "--help"]) == 0
        assert "--up " not in capsys.readouterr().out
