"""What every test of a command may ask for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch

from splatmorph import io
from splatmorph.app import console, run
from splatmorph.gaussians import Gaussians
from splatmorph.landmarks import Landmarks
from splatmorph.morph import agreement

MakeGaussians = Callable[..., Gaussians]
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def few_views(monkeypatch: pytest.MonkeyPatch) -> None:
    """How well halves agree is not what commands are tested by."""
    monkeypatch.setattr(agreement, "views_of", partial(agreement.views_of, count=4))


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Iterator[Run]:
    """``cli("fit", a, b)`` → exit code, stdout, stderr."""

    def call(*words: object) -> tuple[int, str, str]:
        capsys.readouterr()
        code = run([str(word) for word in words])
        return (code, *capsys.readouterr())

    yield call
    console.manner.quiet = console.manner.verbose = False


def bend(points: torch.Tensor) -> torch.Tensor:
    x, y, z = points.unbind(-1)
    return torch.stack([1.2 * x + 0.1 * y**2, y + 0.2 * x, 0.9 * z + 0.1 * x * y], -1)


@pytest.fixture
def pair(
    tmp_path: Path, make_gaussians: MakeGaussians, monkeypatch: pytest.MonkeyPatch
) -> tuple[Path, Path]:
    """Two splats with landmarks beside them, in the current folder."""
    monkeypatch.chdir(tmp_path)
    a = make_gaussians(200, 1)
    b = make_gaussians(150, 0, seed=1)
    b = replace(b, means=bend(b.means))
    points = torch.rand(20, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(5))
    for name, splats, marks in (("a", a, points), ("b", b, bend(points))):
        io.write(f"{name}.ply", splats)
        Landmarks(marks, tuple(f"p{i}" for i in range(20))).write(f"{name}.landmarks.json")
    return Path("a.ply"), Path("b.ply")


@pytest.fixture(scope="module")
def fits() -> list[tuple[str, bytes]]:
    """The files of the one run of ``pair`` that is fitted for all tests."""
    return []


@pytest.fixture
def fitted(pair: tuple[Path, Path], cli: Run, fits: list[tuple[str, bytes]]) -> Path:
    run = Path("a-b.run")
    if not fits:
        assert cli("fit", *pair)[0] == 0
        fits += [(file.name, file.read_bytes()) for file in run.iterdir()]
    run.mkdir(exist_ok=True)
    for name, data in fits:
        (run / name).write_bytes(data)
    return run
