"""The documentation: its links lead somewhere, every page and command is in it."""

from __future__ import annotations

import doctest
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

from splatmorph.app import COMMANDS

HOUSE = Path(__file__).parents[1]
PAGES = sorted([*HOUSE.glob("*.md"), *HOUSE.glob("docs/*.md")])


def slug(title: str) -> str:
    return re.sub(r"[^\w -]", "", title.lower()).strip().replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"```.*?```", "", text, flags=re.S)):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        found = page.parent / path if path else page
        assert found.exists(), f"{page.name} links to {link}"
        if anchor:
            titles = re.findall(r"^#+ (.+)$", found.read_text(encoding="utf-8"), flags=re.M)
            assert anchor in map(slug, titles), f"{page.name} links to {link}"


@pytest.mark.parametrize(
    "module",
    [
        ".".join(path.relative_to(HOUSE).with_suffix("").parts).removesuffix(".__init__")
        for package in ("splatmorph", "renderer")
        for path in sorted((HOUSE / package).rglob("*.py"))
        if re.search(r"^ +>>> ", path.read_text(encoding="utf-8"), flags=re.M)
    ],
)
def test_the_docstrings_examples_hold(module: str) -> None:
    tried = doctest.testmod(importlib.import_module(module))
    assert tried.attempted
    assert not tried.failed


def test_every_page_is_in_the_navigation() -> None:
    listed = set(re.findall(r"(\w+\.md)$", (HOUSE / "mkdocs.yml").read_text(), flags=re.M))
    assert listed == {page.name for page in (HOUSE / "docs").glob("*.md")}


def test_every_command_and_example_is_shown() -> None:
    shown = (HOUSE / "docs/commands.md").read_text(encoding="utf-8")
    assert all(f"splatmorph {name}" in shown for name in COMMANDS)
    shown = (HOUSE / "docs/examples.md").read_text(encoding="utf-8")
    assert all(one.name in shown for one in (HOUSE / "examples").glob("[0-9]*.py"))


def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("mkdocstrings", reason="the extra docs is not installed")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(tmp_path / "s")]
    done = subprocess.run(words, cwd=HOUSE, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "fit_run" in (tmp_path / "s/api/index.html").read_text(encoding="utf-8")
