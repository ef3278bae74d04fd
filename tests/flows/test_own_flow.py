"""A flow of one's own: twenty lines, found by its name, fitted, saved, morphed along."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

import splatmorph as sm
from splatmorph.errors import FitError, OptionError
from splatmorph.fitting import FitConfig, Task, fit, fitted_by
from splatmorph.fitting.methods import _METHODS
from splatmorph.flows import KINDS, Flow, flow_from_config, make_flow
from splatmorph.flows.base import as_column
from splatmorph.flows.network import Network
from splatmorph.flows.node import runge_kutta
from splatmorph.landmarks import Landmarks

ASSETS = Path(__file__).parents[2] / "assets"


@pytest.fixture
def toy() -> Iterator[type[Flow]]:
    """A flow that gives Φ and nothing else."""

    class Toy(Flow):
        kind = "toy"

        def __init__(self, dim: int, *, width: int = 32) -> None:
            super().__init__(dim)
            self.width = width
            self.network = Network([dim, width, width, dim])

        def config(self) -> dict[str, object]:
            return {**super().config(), "width": self.width}

        def unit_forward(self, u: Tensor, t: float | Tensor) -> Tensor:
            return runge_kutta(self.network, u, as_column(t, u), 2)

    yield Toy
    del KINDS["toy"]


def moved(points: Tensor) -> Tensor:
    return 1.1 * points + 0.15 * torch.sin(2 * points.roll(1, dims=1)) + 0.2


def cloud(count: int = 30, dim: int = 3) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return torch.rand(count, dim, generator=generator, dtype=torch.float64) * 2 - 1


def test_it_is_fitted_to_the_sample_pair_by_the_papers_objective(
    toy: type[Flow], tmp_path: Path
) -> None:
    asked = sm.Fitting(flow="toy", steps=60)
    run = sm.fit_run(
        ASSETS / "ines.ply", ASSETS / "otto.ply", out=tmp_path / "x.run", fitting=asked
    )
    (leg,) = run.legs
    assert leg.report["mse"] < 0.05 * leg.report["mse_before"]
    assert leg.report["laws"]["inverse"] < 3e-3
    assert 0 < leg.report["det_min"] < 1
    again = sm.open_run(tmp_path / "x.run")
    assert isinstance(again.legs[0].flow, toy)
    first, second = (each.morph(covariance="fixed").at(0.5).means for each in (run, again))
    assert torch.equal(first, second)


@pytest.mark.parametrize("dim", [2, 3])
def test_what_it_does_not_give_is_differentiated(toy: type[Flow], dim: int) -> None:
    flow = make_flow("toy", dim)
    flow.initialise(torch.Generator().manual_seed(0))
    flow.set_frame(torch.linspace(2.0, 3.0, dim), 1.7)
    x, h = 2 + cloud(6, dim), 1e-5
    torch.testing.assert_close(flow.velocity(x), (flow(x, h) - flow(x, -h)) / (2 * h))
    path, slopes = flow.trajectory_jacobian(x, [0.5, -1.0])
    torch.testing.assert_close(path[1], flow(x, -1.0))
    for j, step in enumerate(torch.eye(dim, dtype=torch.float64) * h):
        found = (flow(x + step, 0.5) - flow(x - step, 0.5)) / (2 * h)
        torch.testing.assert_close(slopes[0, :, :, j], found, rtol=1e-6, atol=1e-8)
        found = (flow.velocity(x + step) - flow.velocity(x - step)) / (2 * h)
        torch.testing.assert_close(flow.velocity_jacobian(x)[..., j], found, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("energy", [None, "hessian", "none"])
def test_the_same_seed_gives_the_same_bits(toy: type[Flow], energy: str | None) -> None:
    source, target = Landmarks(cloud()), Landmarks(moved(cloud()))
    flows = [make_flow("toy", width=8) for _ in range(2)]
    for flow in flows:
        report = fit(flow, source, target, FitConfig(steps=4, energy=energy))
        assert report.mse < report.mse_before
        assert not any(parameter.requires_grad for parameter in flow.parameters())
    first, second = (flow.state_dict() for flow in flows)
    assert all(torch.equal(value, second[name]) for name, value in first.items())


def test_it_may_be_fitted_another_way(toy: type[Flow], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splatmorph.fitting.methods._METHODS", _METHODS.copy())
    seen: list[Task] = []

    @fitted_by(toy)
    def solve(flow: Flow, task: Task) -> bool:
        seen.append(task)
        return True

    fit(make_flow("toy"), Landmarks(cloud()), Landmarks(moved(cloud())))
    assert len(seen) == 1
    assert float(torch.cat([seen[0].p, seen[0].q]).abs().max()) == pytest.approx(1)


def test_what_can_not_be_trained_says_so(toy: type[Flow], monkeypatch: pytest.MonkeyPatch) -> None:
    source, target = Landmarks(cloud()), Landmarks(moved(cloud()))
    monkeypatch.setattr(toy, "unit_forward", lambda self, u, t: u)
    with pytest.raises(FitError, match="can't be differentiated"):
        fit(make_flow("toy"), source, target)
    weightless = make_flow("toy")
    weightless.network = nn.Identity()
    with pytest.raises(FitError, match="no weights to train"):
        fit(weightless, source, target)


def test_a_kind_that_nobody_defined() -> None:
    with pytest.raises(OptionError, match="flow 'toy' is unknown"):
        make_flow("toy")
    with pytest.raises(OptionError, match="flow 'toy' is unknown"):
        flow_from_config({"kind": "toy", "dim": 3})


def test_an_option_that_it_does_not_have(toy: type[Flow]) -> None:
    with pytest.raises(OptionError, match="no option 'depth': choose of width"):
        make_flow("toy", depth=3)
    with pytest.raises(OptionError, match="no option 'centers': it has none"):
        make_flow("linear", centers=3)
