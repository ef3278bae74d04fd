"""The run directory: what was fitted comes back; what is missing or foreign is refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from splatmorph import io
from splatmorph.errors import RunError
from splatmorph.fitting import FitState, fit
from splatmorph.flows import make_flow
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.similarity import Similarity
from splatmorph.landmarks import Landmarks
from splatmorph.runs.inputs import load_input
from splatmorph.runs.run import Leg, Run, load_run, open_run, remember, save_run
from splatmorph.runs.state import load_state, save_state

MakeGaussians = Callable[..., Gaussians]


def bend(points: torch.Tensor) -> torch.Tensor:
    """A smooth warp with no symmetry, so that mixed-up sides or axes show."""
    x, y, z = points.unbind(-1)
    return torch.stack([1.2 * x + 0.1 * y**2, y + 0.2 * x, 0.9 * z + 0.1 * x * y], -1)


@pytest.fixture(scope="module")
def fitted(
    tmp_path_factory: pytest.TempPathFactory, make_gaussians: MakeGaussians
) -> tuple[Path, Run]:
    folder = tmp_path_factory.mktemp("run")
    a = make_gaussians(60)
    b = replace(make_gaussians(70, seed=1), means=bend(make_gaussians(70, seed=1).means))
    points = torch.rand(12, 3, dtype=torch.float64) * 2 - 1
    for name, splats, marks in (("a", a, points), ("b", b, bend(points))):
        io.write(folder / f"{name}.ply", splats)
        Landmarks(marks, tuple("abcdefghijkl")).write(folder / f"{name}.landmarks.json")
    loaded = [load_input(folder / f"{name}.ply") for name in "ab"]
    assert loaded[0].landmarks is not None
    assert loaded[1].landmarks is not None
    flow = make_flow("node", dim=3)
    report = fit(flow, loaded[0].landmarks, loaded[1].landmarks)
    p, q, names = loaded[0].landmarks.match(loaded[1].landmarks)
    leg = Leg(flow, Similarity.identity(), p, q, names, report.to_dict())
    run = Run(tuple(remember(one) for one in loaded), (leg,), {"seed": 0})
    save_run(folder / "a-b.run", run, [report])
    return folder / "a-b.run", run


@pytest.fixture
def copied(fitted: tuple[Path, Run], tmp_path: Path) -> Path:
    shutil.copytree(fitted[0].parent, tmp_path / "moved")
    return tmp_path / "moved" / "a-b.run"


def test_a_saved_run_gives_the_same_flow(fitted: tuple[Path, Run]) -> None:
    folder, run = fitted
    x = torch.rand(20, 3, dtype=torch.float64)
    again = open_run(folder)
    flow, kept = run.legs[0].flow, again.legs[0].flow
    for name, value in flow.state_dict().items():
        assert torch.equal(kept.state_dict()[name], value), name
    torch.testing.assert_close(kept(x, 0.7), flow(x, 0.7), rtol=0, atol=1e-14)
    assert torch.equal(again.legs[0].source_points, run.legs[0].source_points)
    assert again.legs[0].names == run.legs[0].names
    assert {file.name for file in folder.iterdir()} == {
        "morph.json",
        "flow.safetensors",
        "history.csv",
        "report.json",
    }


def test_a_run_moves_with_its_inputs(copied: Path) -> None:
    morph = load_run(copied)
    assert torch.equal(morph.at(0).means, io.read(copied.parent / "a.ply").means)
    assert torch.equal(morph.at(1).means, io.read(copied.parent / "b.ply").means)


def test_inputs_that_moved_or_changed_are_named(
    copied: Path, make_gaussians: MakeGaussians
) -> None:
    io.write(copied.parent / "b.ply", make_gaussians(3))
    with pytest.raises(RunError, match=r"b\.ply has changed"):
        load_run(copied)
    (copied.parent / "a.ply").unlink()
    with pytest.raises(RunError, match=r"a\.ply is not there"):
        load_run(copied)


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="does not exist"):
        open_run(tmp_path / "no")
    (tmp_path / "file").touch()
    with pytest.raises(RunError, match="is a file"):
        open_run(tmp_path / "file")
    with pytest.raises(RunError, match=r"no morph\.json"):
        open_run(tmp_path)


@pytest.mark.parametrize("name", ["morph.json", "report.json", "flow.safetensors"])
@pytest.mark.parametrize("damage", ["missing", "empty", "noise", "foreign"])
def test_damage_is_one_line(copied: Path, name: str, damage: str) -> None:
    path = copied / name
    if damage == "missing":
        path.unlink()
    else:
        noise = {"empty": b"", "noise": b"\x00\xff{", "foreign": b'{"format": 1}'}
        path.write_bytes(noise[damage])
    with pytest.raises(RunError) as caught:
        open_run(copied)
    assert "\n" not in str(caught.value)
    assert str(copied) in str(caught.value)


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("flow", "steps"), "x"),
        (("flow", "steps"), 0),
        (("flow", "rounding"), True),
        (("flow", "field"), ["spline"]),
        (("flow", "dim"), "3"),
        (("names",), ["one"]),
        (("source_points", 0, 0), float("nan")),
        (("source_points", 0, 0), 1e308),
    ],
)
def test_values_of_another_kind_are_one_line(
    copied: Path, place: tuple[str | int, ...], value: object
) -> None:
    manifest = json.loads((copied / "morph.json").read_text())
    there = manifest["legs"][0]
    for step in place[:-1]:
        there = there[step]
    there[place[-1]] = value
    (copied / "morph.json").write_text(json.dumps(manifest))
    with pytest.raises(RunError) as caught:
        open_run(copied)
    assert "\n" not in str(caught.value)
    assert str(copied) in str(caught.value)


def test_another_format_is_told_apart(copied: Path) -> None:
    manifest = json.loads((copied / "morph.json").read_text())
    (copied / "morph.json").write_text(json.dumps(manifest | {"format": 99}))
    with pytest.raises(RunError, match="run format 99"):
        open_run(copied)


def test_an_unfinished_fit_comes_back_only_to_what_asked_for_it(tmp_path: Path) -> None:
    state = FitState({"w": torch.arange(3.0), "empty": torch.zeros(0)}, {"step": "7"})
    assert load_state(tmp_path, 0, "this") is None
    save_state(tmp_path, 0, state, "this")
    again = load_state(tmp_path, 0, "this")
    assert again is not None
    assert again.meta == {"step": "7"}
    assert torch.equal(again.tensors["w"], state.tensors["w"])
    with pytest.raises(RunError, match="other inputs or options"):
        load_state(tmp_path, 0, "that")
    with pytest.raises(RunError, match="`resume`"):
        open_run(tmp_path)
    (tmp_path / "state_0.safetensors").write_bytes(b"half")
    with pytest.raises(RunError, match="can't be resumed"):
        load_state(tmp_path, 0, "this")
