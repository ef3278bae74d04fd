"""A fit from Python: the same run as from the command line, and refusals that name parameters."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import splatmorph as sm
from splatmorph import io
from splatmorph.errors import LandmarkError, OptionError, OutputExistsError, WriteError
from splatmorph.fitting import FitProgress
from splatmorph.gaussians import Gaussians
from splatmorph.landmarks import Landmarks
from splatmorph.registration import Found
from splatmorph.runs.inputs import as_in_file
from splatmorph.runs.request import DEFAULT_FITTING, Request, made_by_search

MakeGaussians = Callable[..., Gaussians]


@pytest.fixture
def splats(tmp_path: Path, make_gaussians: MakeGaussians, monkeypatch: pytest.MonkeyPatch) -> Path:
    """a, b and c with landmarks beside them, and the current folder there."""
    monkeypatch.chdir(tmp_path)
    points = torch.rand(12, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(5))
    for i, name in enumerate("abc"):
        io.write(tmp_path / f"{name}.ply", make_gaussians(60, 0, seed=i))
        moved = points * (1 + 0.1 * i) + 0.05 * i * points.roll(1, 1) ** 2
        marks = Landmarks(moved, tuple(f"p{k}" for k in range(12)))
        marks.write(tmp_path / f"{name}.landmarks.json")
    return tmp_path


def test_a_run_is_made_in_one_call(splats: Path) -> None:
    steps: list[FitProgress] = []
    run = sm.fit_run("a.ply", "b.ply", out="x.run", on_step=steps.append)
    assert run.folder == Path("x.run")
    assert steps
    (leg,) = run.legs
    assert leg.report["mse"] < 1e-6 < leg.report["mse_before"]
    morph = run.morph()
    assert torch.equal(morph.at(0).means, io.read("a.ply").means)
    assert torch.equal(morph.at(1).means, io.read("b.ply").means)
    again = sm.load_run("x.run", ramp="linear")
    assert isinstance(again, sm.Morph)
    assert torch.equal(again.at(0.5).means, run.morph(ramp="linear").at(0.5).means)


def test_more_than_two_are_a_chain_and_a_mean_an_average(splats: Path) -> None:
    assert isinstance(sm.fit_run("a.ply", "b.ply", "c.ply").morph(), sm.Chain)
    mean = sm.fit_run("a.ply", "b.ply", "c.ply", mean=True)
    assert Path("a-b-c.run").is_dir()
    assert mean.folder == Path("a-b-c-mean.run")
    assert len(mean.average())
    with pytest.raises(OptionError, match="no t"):
        mean.morph()


@pytest.fixture
def searches(splats: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """No landmarks beside a, b and c, and a search that finds some at once; its methods."""
    made: list[str] = []

    def search(source: Gaussians, target: Gaussians, method: str, **_: object) -> Found:
        made.append(method)
        names = tuple(f"auto_{i:04d}" for i in range(1, 13))
        sure = torch.full((12,), 0.5)
        ends = (Landmarks(one.means[:12], names, sure) for one in (source, target))
        return Found(*ends, "surfaces", 0.5, ())

    monkeypatch.setattr("splatmorph.runs.finding.find_landmarks", search)
    for name in "abc":
        (splats / f"{name}.landmarks.json").unlink()
    return made


def test_what_is_found_on_the_first_is_common_to_all_of_a_mean(searches: list[str]) -> None:
    run = sm.fit_run("a.ply", "b.ply", "c.ply", mean=True)
    assert len(searches) == 2
    assert [len(leg.names) for leg in run.legs] == [12, 12, 12]
    for leg, name in zip(run.legs, "abc", strict=True):
        assert torch.equal(leg.source_points, io.read(f"{name}.ply").means[:12].double())
    with pytest.raises(LandmarkError, match="no landmarks"):
        sm.fit_run("a.ply", "b.ply", mean=True, finding=sm.Finding(auto=False), out="x.run")


def test_what_is_found_is_written_in_the_coordinates_of_the_file(
    searches: list[str], splats: Path
) -> None:
    far = (4e5, 5e6, 100.0)
    there = replace(io.read("a.ply"), offset=far)
    points = as_in_file(Landmarks(there.means[:5]), there).points
    assert torch.equal(points, there.means[:5].double() + torch.tensor(far, dtype=torch.float64))
    sm.fit_run("a.ply", "b.ply")
    Path("a-b.run/a.landmarks.json").rename("a.landmarks.json")
    found = sm.load_input("a.ply").landmarks
    assert found is not None
    assert torch.equal(found.points, io.read("a.ply").means[:12].double())


def test_a_run_of_a_search_is_known_without_searching_again(searches: list[str]) -> None:
    run = sm.fit_run("a.ply", "b.ply")
    box = sm.Finding(crop=(-9, -9, -9, 9, 9, 9))
    other = sm.fit_run("a.ply", "b.ply", finding=box, out="box.run")
    asked = len(searches)

    def made(run: sm.Run, finding: sm.Finding, fitting: sm.Fitting = DEFAULT_FITTING) -> bool:
        return made_by_search(run, ["a.ply", "b.ply"], fitting, sm.Posing(), finding)

    for one in (run, sm.open_run(run.folder or "")):
        assert made(one, sm.Finding())
        assert not made(one, box)
        assert not made(one, sm.Finding(), sm.Fitting(smoothing=0))
    assert made(sm.open_run(other.folder or ""), box)
    Landmarks.read("a-b.run/a.landmarks.json").write("a.landmarks.json")
    Landmarks.read("a-b.run/b.landmarks.json").write("b.landmarks.json")
    assert not made(run, sm.Finding())
    assert len(searches) == asked


def test_a_request_knows_its_own_run(splats: Path) -> None:
    run = sm.fit_run("a.ply", "b.ply")
    again = sm.open_run("a-b.run")
    assert Request.of(["a.ply", "b.ply"]).made(run)
    assert Request.of(["a.ply", "b.ply"]).made(again)
    assert not Request.of(["a.ply", "c.ply"]).made(again)
    assert not Request.of(["a.ply", "b.ply"], sm.Fitting(smoothing=0)).made(again)
    assert not Request.of(["a.ply", "b.ply"], posing=sm.Posing(landmarks_count=6)).made(again)


def test_an_interrupted_run_goes_on_to_the_same_bits(splats: Path) -> None:
    asked = sm.Fitting(field="siren", steps=40)
    whole = sm.fit_run("a.ply", "b.ply", "c.ply", fitting=asked, out="whole.run")
    begun: list[int] = []

    def impatient(progress: FitProgress) -> None:
        begun.append(progress.step)
        if begun.count(20) == 2 and progress.step == 20:
            raise KeyboardInterrupt

    cut = sm.fit_run("a.ply", "b.ply", "c.ply", fitting=asked, out="cut.run", on_step=impatient)
    assert [leg.report["interrupted"] for leg in cut.legs] == [False, True]
    with pytest.raises(OutputExistsError, match="`overwrite`"):
        sm.fit_run("a.ply", "b.ply", "c.ply", fitting=asked, out="cut.run")
    cut = sm.fit_run("a.ply", "b.ply", "c.ply", fitting=asked, out="cut.run", resume=True)
    for one, other in zip(cut.legs, whole.legs, strict=True):
        for name, value in other.flow.state_dict().items():
            assert torch.equal(one.flow.state_dict()[name], value), name


def test_warnings_are_called_or_logged(splats: Path, caplog: pytest.LogCaptureFixture) -> None:
    marks = Landmarks.read("b.landmarks.json")
    assert marks.names is not None
    points = marks.points.clone()
    points[0] = points[1] + 1e-3
    Landmarks(points, marks.names).write("b.landmarks.json")
    warned: list[str] = []
    sm.fit_run("a.ply", "b.ply", on_warning=warned.append)
    assert any("p0 and p1" in line for line in warned)
    with caplog.at_level(logging.WARNING, "splatmorph"):
        sm.fit_run("a.ply", "b.ply", overwrite=True)
    assert [record.message for record in caplog.records] == warned


def test_what_can_not_be_asked_for(splats: Path) -> None:
    with pytest.raises(OptionError, match="1 splats are given"):
        sm.fit_run("a.ply")
    with pytest.raises(OptionError, match="pose_from is 'both'"):
        sm.Posing(pose_from="both")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="landmark_set"):
        sm.load_input("a.ply", landmark_set="254")  # type: ignore[call-arg]
    with pytest.raises(WriteError, match="`out`"):
        sm.fit_run("a.ply", "b.ply", out="a.ply")
    Path("b.landmarks.json").unlink()
    with pytest.raises(LandmarkError, match="`target_landmarks`"):
        sm.fit_run("a.ply", "b.ply", finding=sm.Finding(auto=False))
    assert not list(Path().glob("*.run"))
