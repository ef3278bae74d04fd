"""The example of avatars runs as it stands."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "02_avatars.py"


def test_two_avatars_talk_while_one_becomes_the_other(
    anna: Path, ben: Path, flame_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SPLATMORPH_FLAME", str(flame_folder))
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), str(anna), str(ben)])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    assert len(list(tmp_path.glob("talking_*.ply"))) == 3
