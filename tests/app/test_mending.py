"""What a command says of landmarks that it found and isn't sure of."""

from __future__ import annotations

import shlex
from pathlib import Path

import torch

from splatmorph.app.landmarks import how_to_mend
from splatmorph.landmarks import Landmarks
from splatmorph.registration import Found


def test_doubtful_landmarks_are_mended_by_a_command_that_can_be_typed() -> None:
    line = how_to_mend(Path("my a.ply"), Path("b.ply"), Path("out"), start="auto")
    typed = shlex.split(line.split(": ")[1])
    expected = ["splatmorph", "pick", "my a.ply", "b.ply", "-o", "out", "--start", "auto"]
    assert typed == expected


def test_what_is_unsure_or_warned_of_is_doubtful() -> None:
    points = Landmarks(torch.rand(5, 3))

    def found(sure: float, *warnings: str) -> Found:
        return Found(points, points, "surfaces", sure, warnings)

    assert found(0.3).doubtful
    assert found(0.9, "two poses fit about as well").doubtful
    assert not found(0.6).doubtful
