"""What a command is expected to answer."""

from __future__ import annotations


def failed(result: tuple[int, str, str], *words: str, code: int = 1) -> None:
    got, _, err = result
    assert got == code, result
    assert "Traceback" not in err
    if code == 1:
        assert err.count("\n") == 1, err
        assert err.startswith("error: ")
    for word in words:
        assert word in err.replace("\n", " "), err
