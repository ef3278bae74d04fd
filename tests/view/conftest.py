"""What the tests of pages share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from browser import Browser


@pytest.fixture(scope="module")
def browsers() -> Iterator[list[Browser]]:
    """The one browser of a module, started by the first test that gets that far."""
    started: list[Browser] = []
    yield started
    for browser in started:
        browser.close()
