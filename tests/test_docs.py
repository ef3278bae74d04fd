"""The documentation: its links lead somewhere, every page and command is in it."""

from __future__ import annotations

import doctest
import html
import importlib
import re
import shlex
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from splatmorph.app import COMMANDS, app

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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_line_that_is_typed_is_understood(page: Path) -> None:
    """Parsed, not run: the README's are run by the tests of the examples."""
    text = page.read_text(encoding="utf-8")
    lines = re.findall(r"^ *(splatmorph [a-z]+ .+)$", text, flags=re.M)
    if page.name == "commands.md":
        lines += re.findall(r"`(splatmorph [a-z]+ [^`]+)`", text)
    for line in lines:
        words = shlex.split(line, comments=True)[1:]
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            app.parse_args(words, exit_on_error=False, print_error=False)


def test_every_benchmark_is_named_and_every_figure_has_one() -> None:
    scripts = {path.name for path in (HOUSE / "benchmarks").glob("*.py")} - {"pairs.py"}
    text = (HOUSE / "docs/benchmarks.md").read_text(encoding="utf-8")
    assert set(re.findall(r"benchmarks/(\w+\.py)", text)) == scripts
    for page in re.findall(r"\((\w+\.md)\) \| `python", text):
        said = (HOUSE / "docs" / page).read_text(encoding="utf-8")
        assert "benchmarks/" in said, f"{page} has figures and names no command for them"


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
    page = (tmp_path / "s/examples/index.html").read_text(encoding="utf-8")
    shown = html.unescape(re.sub(r"<[^>]+>", "", page))
    assert shown.count("import splatmorph as sm") > 4
    assert "8<" not in shown.replace(" ", "")
