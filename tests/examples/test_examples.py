"""The examples run as they stand, on a thinned sample pair; so do the README's blocks.

That of avatars is run beside their tests.
"""

from __future__ import annotations

import json
import re
import runpy
import shlex
import sys
from pathlib import Path

import pytest

from splatmorph import io
from splatmorph.app import run
from splatmorph.samples import sample_pair

HOUSE = Path(__file__).parents[2]
EXAMPLES = sorted((HOUSE / "examples").glob("[0-9]*.py"))
WRITES = {"00": "half.ply", "01": "half.ply", "03": "row.png", "04": "small.run"}
WRITES |= {"05": "loop.mp4", "06": "morph.usdc"}
EVERY = 60
"""Of the sample pair's splats, one in so many."""


@pytest.fixture(scope="module")
def thinned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """a.ply and b.ply with their landmarks."""
    folder = tmp_path_factory.mktemp("pair")
    for name, (splats, marks) in zip("ab", sample_pair(), strict=True):
        io.write(folder / f"{name}.ply", splats.select(slice(None, None, EVERY)))
        marks.write(folder / f"{name}.landmarks.json")
    return folder


@pytest.mark.parametrize(
    "example", [one for one in EXAMPLES if "avatars" not in one.stem], ids=lambda path: path.stem
)
def test_an_example_runs(
    example: Path, thinned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    number = example.name[:2]
    if number == "06":
        pytest.importorskip("pxr", reason="usd-core is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(example), *(str(thinned / f"{n}.ply") for n in "ab")])
    runpy.run_path(str(example), run_name="__main__")
    assert (tmp_path / WRITES[number]).exists()
    if number == "04":
        from splatmorph.flows.base import KINDS

        del KINDS["small"]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short(example: Path) -> None:
    assert len(example.read_text(encoding="utf-8").splitlines()) < 40


@pytest.mark.long
def test_the_notebook_runs() -> None:
    book = json.loads((HOUSE / "examples/step_by_step.ipynb").read_text(encoding="utf-8"))
    names: dict[str, object] = {}
    for cell in book["cells"]:
        if cell["cell_type"] == "code":
            assert not cell["outputs"], "kept without outputs"
            exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
    assert len(names["pictures"]) == 5


def blocks(language: str) -> list[str]:
    text = (HOUSE / "README.md").read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.M | re.S)


def test_every_line_of_the_readme_is_typed(
    thinned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for file in thinned.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "pairs.csv").write_text("source,target\na.ply,b.ply\n")
    monkeypatch.chdir(tmp_path)
    typed = []
    for line in "".join(blocks("sh")).splitlines():
        words = shlex.split(line, comments=True)
        if not words or words[0] != "splatmorph":
            continue
        quick = {"render": ["--size", "32x32"]}.get(words[1], [])
        if words[1] == "render" and "--sheet" not in words:
            quick += ["--frames", "2"]
        assert run([*words[1:], *quick]) == 0, line
        typed.append(words[1])
    assert {"fit", "render", "export", "view", "batch"} <= set(typed)


def test_the_readmes_python_runs(
    thinned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for file in thinned.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    monkeypatch.chdir(tmp_path)
    (code,) = blocks("python")
    exec(compile(code, "README.md", "exec"), {})
    assert Path("half.ply").is_file()
