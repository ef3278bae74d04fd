"""What every test of a command may ask for."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from splatmorph.app import console, run

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Iterator[Run]:
    """``cli("fit", a, b)`` → exit code, stdout, stderr."""

    def call(*words: object) -> tuple[int, str, str]:
        capsys.readouterr()
        code = run([str(word) for word in words])
        return (code, *capsys.readouterr())

    yield call
    console.manner.quiet = console.manner.verbose = False
