"""How every reader refuses what it can't read."""

from __future__ import annotations

from pathlib import Path

import pytest

from splatmorph import io
from splatmorph.errors import ReadError


def refused(path: Path, *words: str, error: type[ReadError] = ReadError) -> None:
    """Reading ``path`` fails with one line that names it and says these words."""
    with pytest.raises(error) as caught:
        io.read(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    for word in words:
        assert word in message, message
