"""The benchmark of many faces: its pairs, its table, its refusals, on faces that aren't any."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import torch
from PIL import Image
from scenes import painted

from benchmarks import frll

SIDE = 64


@pytest.fixture
def faces(tmp_path: Path) -> Path:
    """Three pictures with templates, whose points 3 and 4 fall together in the second."""
    draw = torch.Generator().manual_seed(4)
    grid = torch.cartesian_prod(*[torch.tensor([12.0, 32.0, 52.0])] * 2)
    for i in range(3):
        folder = tmp_path / "faces" / str(i % 2)
        folder.mkdir(parents=True, exist_ok=True)
        Image.fromarray(painted(SIDE, SIDE, seed=i).pixels).save(folder / f"00{i}.png")
        points = grid + 4 * torch.rand(9, 2, generator=draw)
        if i == 1:
            points[4] = points[3]
        lines = [f"{x:.3f}\t{y:.3f}" for x, y in points.tolist()]
        (folder / f"00{i}.tem").write_text("\n".join(["9", *lines, "0"]) + "\n")
    (tmp_path / "faces" / "alone.tem").write_text("9\n")
    return tmp_path / "faces"


def measured(monkeypatch: pytest.MonkeyPatch, *words: object) -> None:
    monkeypatch.setattr(sys, "argv", ["frll.py", *map(str, words)])
    frll.main()


def rows_of(printed: str) -> dict[str, list[str]]:
    cells = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in printed.splitlines()
        if line.startswith("|")
    ]
    return {row[0]: row[1:] for row in cells}


def test_pairs_are_morphed_by_each_method(
    faces: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = (faces, "-o", tmp_path / "out", "--methods", "node,tps,delaunay", "--size", "32x32")
    measured(monkeypatch, *words)
    first = capsys.readouterr().out
    assert first.startswith("3 pairs of 3 faces, 8 landmarks\n")
    rows = rows_of(first)
    assert set(rows) == {"", "---", "node", "tps", "delaunay", *frll.PAPER}
    assert all(len(row) == len(frll.COLUMNS) for row in rows.values())
    for method in ("node", "tps"):
        assert float(rows[method][2]) < 1e-4
        assert rows[method][-2:] == ["0", ""]
    assert rows["siren"][-1] == "1.4e-04"
    assert len(list((tmp_path / "out").glob("*/*.png"))) == 9
    measured(monkeypatch, *words)
    assert capsys.readouterr().out == first


def test_a_pair_that_fails_is_counted(
    faces: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = (faces, "-o", tmp_path / "out", "--methods", "tps", "--size", "32x32")
    monkeypatch.setattr(frll, "METHODS", {"tps": "--warp tps --max-pixels 1"})
    measured(monkeypatch, *words)
    assert rows_of(capsys.readouterr().out)["tps"][-2] == "3"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--lpips-weights", "nowhere"), "nowhere holds no weights of torchvision's"),
        (("--inception-weights", "nothing.pth"), "can't read nothing.pth"),
    ],
)
def test_wrong_weights_are_one_line_before_any_work(
    faces: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, str], said: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        measured(monkeypatch, faces, "-o", tmp_path / "out", *words)
    assert said in str(ended.value.code)
    assert "\n" not in str(ended.value.code)
    assert not (tmp_path / "out").exists()


def test_pictures_are_looked_at(
    faces: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Difference:
        trunk = "alex"

        def __call__(self, a: torch.Tensor, b: torch.Tensor) -> float:
            return float((a - b).abs().mean())

    class Means:
        def features(self, pictures: object) -> torch.Tensor:
            return torch.stack([picture.mean((1, 2)) for picture in pictures]).double()

    monkeypatch.setattr(frll.Lpips, "load", lambda _: Difference())
    monkeypatch.setattr(frll.Inception, "load", lambda _: Means())
    seen = ("--lpips-weights", "x", "--inception-weights", "y", "--methods", "tps,delaunay")
    measured(monkeypatch, faces, "-o", tmp_path / "out", "--size", "32x32", *seen)
    printed = capsys.readouterr().out
    table = rows_of(printed[printed.index("LPIPS by alex, FID to 3 faces") :])
    assert table["tps"][3:5] == ["0.371", "0.374"]
    for method in ("tps", "delaunay"):
        to_source, to_target, fid = map(float, table[method][:3])
        assert 0 < to_source < 0.5
        assert 0 < to_target < 0.5
        assert fid > 0
