"""What works without any extra, and what says which it needs."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest
from outcomes import failed
from PIL import Image

Run = Callable[..., tuple[int, str, str]]
pytestmark = pytest.mark.usefixtures("few_views")
HOUSE = Path(__file__).parents[2]
OF_EXTRAS = {
    "cv2": "faces",
    "viser": "view",
    "diffusers": "generative",
    "pxr": "usd",
    "lpips": "metrics",
}


@pytest.fixture(autouse=True)
def bare(monkeypatch: pytest.MonkeyPatch) -> None:
    """As though no extra were installed."""
    for name in [*OF_EXTRAS, "trame"]:
        for loaded in [one for one in sys.modules if one == name or one.startswith(f"{name}.")]:
            monkeypatch.delitem(sys.modules, loaded)
        monkeypatch.setitem(sys.modules, name, None)


def test_two_splats_to_everything_that_a_morph_is_shown_by(
    pair: tuple[Path, Path], cli: Run
) -> None:
    for words in (
        ("inspect", "a.ply"),
        ("fit", *pair),
        ("render", "a-b.run", "--size", "32x32", "--frames", "2"),
        ("render", "a-b.run", "--sheet", "--size", "32x32"),
        ("export", "a-b.run", "--frames", "2"),
        ("view", "a-b.run", "-o", "a.html"),
        ("eval", "a-b.run"),
        *(
            ("export", "a-b.run", "--t", "0.5", "-o", f"half.{kind}")
            for kind in ("spz", "sog", "glb")
        ),
    ):
        code, _, err = cli(*words)
        assert code == 0, (words, err)


@pytest.mark.parametrize(
    ("words", "extra"),
    [
        (("view", "a.ply"), "view"),
        (("export", "a-b.run", "-o", "morph.usdc"), "usd"),
        (("image", "c.png", "d.png"), "images"),
    ],
)
def test_what_needs_an_extra_names_it(
    pair: tuple[Path, Path], cli: Run, words: tuple[str, ...], extra: str
) -> None:
    if "a-b.run" in words:
        assert cli("fit", *pair)[0] == 0
    for name in ("c.png", "d.png"):
        Image.new("RGB", (32, 32)).save(name)
    failed(cli(*words), f"pip install 'splatmorph[{extra}]'")


def test_every_extra_that_is_named_can_be_installed() -> None:
    named = set(OF_EXTRAS.values())
    for path in (HOUSE / "splatmorph").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        named |= set(re.findall(r'MissingExtraError\("[^"]+", "(\w+)"', text))
    assert {"view", "usd"} <= named
    project = tomllib.loads((HOUSE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert named <= set(project["optional-dependencies"])


@pytest.mark.parametrize("package", ["splatmorph", "renderer"])
def test_the_types_are_there_for_checkers(package: str) -> None:
    assert Path(find_spec(package).submodule_search_locations[0], "py.typed").is_file()
