"""C++: compiled or else left out, twins compared, processes and threads."""

from __future__ import annotations

import ctypes
import logging
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from random_scenes import assert_same_picture, pinhole, random_scene

from renderer import rasterize, rasterize_reference
from renderer.cpp import Program, build, plain_twins
from renderer.native import layout
from splatmorph.fitting import FitConfig, fit
from splatmorph.flows import make_flow
from splatmorph.flows.native import jet, path
from splatmorph.landmarks import Landmarks
from splatmorph.morph.native import shapes

ROOT = Path(__file__).parents[2]
HEADERS = [*ROOT.glob("renderer/*/*.h"), *ROOT.glob("splatmorph/*/native/*.h")]

ADD = """
struct Arguments {
    const long long* numbers;
    long long* sums;
    int count;
};
const Arguments& given = *(const Arguments*)arguments;
for (int i = part; i < given.count; i += parts) given.sums[i] += given.numbers[i];
"""


class Arguments(ctypes.Structure):
    _fields_ = (
        ("numbers", ctypes.c_void_p),
        ("sums", ctypes.c_void_p),
        ("count", ctypes.c_int),
    )


class Misplaced(ctypes.Structure):
    _fields_ = (
        ("numbers", ctypes.c_void_p),
        ("count", ctypes.c_int),
        ("sums", ctypes.c_void_p),
    )


def program(folder: Path, source: str = ADD, arguments: type = Arguments) -> Program:
    (folder / "add.h").write_text(source)
    return Program(folder, ("add.h",), arguments, dtype="int64")


@pytest.fixture
def said(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What the renderer logs, from a process that has said nothing yet."""
    monkeypatch.setattr("renderer.cpp.program._failures", set())
    monkeypatch.setattr(logging.getLogger("renderer"), "propagate", True)
    messages: list[str] = []
    monkeypatch.setattr(caplog.handler, "emit", lambda record: messages.append(record.getMessage()))
    return messages


def test_every_argument_in_turn_and_every_part_at_once(tmp_path: Path) -> None:
    numbers, sums = torch.arange(5001), torch.zeros(5001, dtype=torch.int64)
    add = program(tmp_path)
    assert add.takes(numbers, sums)
    arguments = Arguments(numbers.data_ptr(), sums.data_ptr(), len(sums))
    for parts in (1, 2, 3):
        add.run([arguments, arguments], parts)
    assert torch.equal(sums, 6 * numbers)


def test_the_rule_when_it_is_taken(tmp_path: Path) -> None:
    add = program(tmp_path)
    many = torch.zeros(3000, dtype=torch.int64)
    assert add.takes(many)
    assert not add.takes(many[:1999])
    assert add.takes(many[:5], fewest=5)
    assert not add.takes(many.int())
    assert not add.takes(many, torch.zeros(1, requires_grad=True))
    with plain_twins():
        assert not add.takes(many)
        with pytest.raises(RuntimeError, match="doesn't run here"):
            add.run(Arguments(), 1)


def test_a_typo_is_named_once_with_its_file_and_line(tmp_path: Path, said: list[str]) -> None:
    broken = ADD.replace("given.count;", "given.cuont;")
    for _ in range(2):
        assert not program(tmp_path, broken).available()
    (message,) = [line for line in said if "add.h" in line]
    assert f"{tmp_path.as_posix()}/add.h:8: no member named 'cuont'" in message


def test_twins_that_differ_do_not_compile(tmp_path: Path, said: list[str]) -> None:
    assert not program(tmp_path, ADD, Misplaced).available()
    assert any("Arguments::count has another place in Python" in line for line in said)


def test_all_works_where_nothing_compiles(monkeypatch: pytest.MonkeyPatch, said: list[str]) -> None:
    def refuse(source: str) -> None:
        raise build.BuildError("some.h:3: expected ';'")

    monkeypatch.setattr(build, "build", refuse)
    monkeypatch.setattr(layout.PROGRAM, "_launch", None)
    monkeypatch.setattr(layout.PROGRAM, "_tried", False)
    for module in (jet, path, shapes):
        module._program.cache_clear()
    try:
        scene, camera = random_scene(60, 1, 1), pinhole(40, 30)
        assert_same_picture(rasterize(**scene, **camera), rasterize_reference(**scene, **camera))
        x = torch.rand(2000, 3)
        assert make_flow("node")(x, 0.5).shape == x.shape
        source = Landmarks(torch.rand(20, 3, dtype=torch.float64))
        fit(make_flow("ncf"), source, Landmarks(source.points + 0.1), FitConfig(steps=2))
    finally:
        for module in (jet, path, shapes):
            module._program.cache_clear()
    (message,) = [line for line in said if "some.h" in line]
    assert message.startswith("some.h:3: expected ';': C++ is left out")


@pytest.mark.parametrize("header", HEADERS, ids=lambda header: header.name)
def test_headers_balance_their_braces(header: Path) -> None:
    depth = 0
    for line in header.read_text(encoding="utf-8").splitlines():
        for bracket in line.split("//")[0]:
            depth += (bracket in "({[") - (bracket in ")}]")
            assert depth >= 0, line
    assert depth == 0


def run(*command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A Python of its own in the folder of this file."""
    return subprocess.run(
        [sys.executable, *command],
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


TOY = """
import tempfile
from pathlib import Path
from test_cpp import program
print(program(Path(tempfile.mkdtemp())).available())
"""


def test_more_parts_need_no_other_change(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "renderer", tmp_path / "renderer")
    changed = tmp_path / "renderer" / "native" / "layout.py"
    changed.write_text(changed.read_text().replace("PARTS = 16", "PARTS = 32"))
    script = """
from random_scenes import assert_same_picture, pinhole, random_scene
from renderer import native, rasterize, rasterize_reference
assert native.PARTS == 32 and native.PROGRAM.available()
scene, camera = random_scene(300, 1, 1), pinhole(70, 90)
assert_same_picture(rasterize(**scene, **camera), rasterize_reference(**scene, **camera))
"""
    done = run("-c", script, PYTHONPATH=str(tmp_path))
    assert done.returncode == 0, done.stderr


def test_a_cache_that_cannot_be_written_is_replaced_for_now(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = run("-c", TOY, WARP_CACHE_PATH=str(tmp_path / "file" / "cache"), TMPDIR=str(tmp_path))
    assert done.stdout == "True\n", done.stderr
    assert done.stderr.count("can't be written (Not a directory)") == 1
    assert not list(tmp_path.glob("kernels-*"))


def test_processes_fill_a_cold_cache_together(tmp_path: Path) -> None:
    command = [sys.executable, "-c", TOY]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "WARP_CACHE_PATH": str(tmp_path)}
    folder = Path(__file__).parent
    together = [
        subprocess.Popen(command, env=environment, cwd=folder, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    assert [one.communicate(timeout=300)[0] for one in together] == ["True\n", "True\n"]


@pytest.mark.parametrize(
    "when",
    [
        *(pytest.param(when, marks=pytest.mark.long) for when in ("before", "after", "during")),
        "compiling",
    ],
)
@pytest.mark.parametrize("method", ["fork", "spawn", "forkserver"])
def test_children_draw_as_their_parent(method: str, when: str) -> None:
    if not hasattr(os, "fork") and method != "spawn":
        pytest.skip("this system has no fork")
    done = run("fork_script.py", method, when)
    assert done.returncode == 0, done.stderr
    ours, *theirs = map(float, done.stdout.split())
    assert theirs
    assert set(theirs) == {ours}
    np.testing.assert_equal(ours > 0, True)
