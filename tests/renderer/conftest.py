"""What the renderer's tests may ask for."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from renderer import native, portable
from renderer.cpp import plain_twins


@pytest.fixture(params=["native", "portable"])
def each_path(request: pytest.FixtureRequest) -> Iterator[str]:
    """Run the test with the vector path and with the portable one."""
    if request.param == "portable":
        with plain_twins():
            yield "portable"
    else:
        assert native.PROGRAM.available(), "the headers don't compile on this machine"
        yield "native"


@pytest.fixture
def small_lists(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Let the tile lists hold no more than so many entries at a time."""

    def limit(entries: int) -> None:
        monkeypatch.setattr(native, "LIST_ENTRIES", entries)
        monkeypatch.setattr(portable, "LIST_BUDGET", entries)
        monkeypatch.setattr(native, "_memory", native._Memory())

    return limit
