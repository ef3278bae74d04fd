"""What the tests of pages share."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from browser import Browser, find_browser
from pick_cases import ASSETS
from pick_visit import Visit, visiting

from splatmorph.landmarks import Landmarks
from splatmorph.view.pick import Desk, open_desk


@pytest.fixture(scope="module")
def browsers() -> Iterator[list[Browser]]:
    """The one browser of a module, started by the first test that gets that far."""
    started: list[Browser] = []
    yield started
    for browser in started:
        browser.close()


@pytest.fixture
def visits(browsers: list[Browser], tmp_path: Path) -> Iterator[Callable[..., Visit]]:
    """``visits("ines", "otto")``: the picker's page open on copies of these, without landmarks."""
    program = find_browser()
    if program is None:
        pytest.skip("no Chromium here (apt-get install chromium, or set SPLATMORPH_TEST_BROWSER)")
    with contextlib.ExitStack() as until_the_end:

        def visit(*names: str) -> Visit:
            if not browsers:
                browsers.append(Browser(program, 1300, 760, offline=False))
            return until_the_end.enter_context(visiting(browsers[0], tmp_path, *names))

        yield visit


@pytest.fixture(scope="module")
def truth() -> tuple[Landmarks, Landmarks]:
    return Landmarks.read(ASSETS / "ines.landmarks.json"), Landmarks.read(
        ASSETS / "otto.landmarks.json"
    )


@pytest.fixture
def pair(tmp_path: Path) -> list[Path]:
    """The sample pair without its landmarks."""
    return [Path(shutil.copy(ASSETS / f"{name}.ply", tmp_path)) for name in ("ines", "otto")]


@pytest.fixture
def desk(pair: list[Path]) -> Desk:
    return open_desk(pair)
