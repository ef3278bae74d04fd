"""Metrics on what they must say, and the command that reports them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from flow_cases import points, random_flow

from splatmorph import io
from splatmorph.app import run
from splatmorph.flows import make_flow
from splatmorph.gaussians import Gaussians
from splatmorph.landmarks import Landmarks
from splatmorph.metrics import evaluate, flow_laws, landmark_mse
from splatmorph.runs import open_run

MakeGaussians = Callable[..., Gaussians]


def test_landmark_mse_of_doing_nothing_is_the_distance() -> None:
    p = torch.rand(9, 3, dtype=torch.float64)
    q = p + torch.tensor([0.3, 0.0, 0.0], dtype=torch.float64)
    assert landmark_mse(make_flow("linear"), p, q) == pytest.approx(0.09 / 3)


def test_landmark_mse_of_the_flow_that_made_the_target_is_zero() -> None:
    flow = random_flow({"kind": "ncf"}, 3, 0)
    p = points(flow, 9, 0)
    assert landmark_mse(flow, p, flow(p, 1.0)) < 1e-20


def test_laws_tell_a_flow_from_a_displacement() -> None:
    for options, broken in (({"kind": "ncf"}, False), ({"kind": "tps"}, True)):
        flow = random_flow(options, 3, 1)
        laws = flow_laws(flow, points(flow, 50, 1))
        assert laws.identity < 1e-12
        assert (laws.inverse > 1e-3) == broken
        assert (laws.group > 1e-3) == broken


def test_energies_of_an_affine_velocity_are_known() -> None:
    flow = make_flow("node")
    slope = torch.tensor([[1.0, 2.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.0]])
    flow.field.affine[1:] = slope.T
    flow.set_frame(torch.ones(3), 2.0)
    x = points(flow, 30, 0)
    quality = evaluate(flow, x, flow(x, 1.0), tuple("a" * i for i in range(30)), x)
    assert quality.energy_first == pytest.approx(5.25)
    assert quality.energy_second == pytest.approx(0, abs=1e-9)
    assert quality.det_min == pytest.approx(math.exp(1.5), rel=1e-6)
    assert quality.det_max == pytest.approx(math.exp(1.5), rel=1e-6)
    assert quality.scale == 2


STRETCH = torch.tensor([1.6, 1.0, 0.9])
"""More than a similarity, which would be taken out before the fit."""


@pytest.fixture
def fitted(tmp_path: Path, make_gaussians: MakeGaussians, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run of a splat and a stretched one."""
    monkeypatch.chdir(tmp_path)
    splats = make_gaussians(60, 0)
    marks = splats.means[:20].double()
    for name, factor in (("a", torch.ones(3)), ("b", STRETCH)):
        io.write(f"{name}.ply", replace(splats, means=splats.means * factor))
        Landmarks(marks * factor, tuple(f"p{i}" for i in range(20))).write(f"{name}.landmarks.json")
    assert run(["-q", "fit", "a.ply", "b.ply"]) == 0
    return Path("a-b.run")


def test_eval_measures_a_run(fitted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = torch.rand(30, 3).numpy() - 0.5
    np.savez("dense.npz", source=truth, target=truth * STRETCH.numpy())
    np.savetxt("dense.csv", np.hstack([truth, truth * STRETCH.numpy()]), delimiter=",")
    for held in ("dense.npz", "dense.csv"):
        capsys.readouterr()
        assert run(["eval", str(fitted), "--held-out", held, "--json"]) == 0
        (leg,) = json.loads(capsys.readouterr().out)["legs"]
        assert leg["held_out"]["points"] == 30
        assert leg["held_out"]["mean"] < 1e-3 * leg["held_out"]["mean_before"]
        assert leg["mse"] < 1e-6 < leg["mse_before"]
        volume = float(STRETCH.prod()) / open_run(fitted).legs[0].frame.scale ** 3
        assert leg["det_min"] == pytest.approx(volume, rel=1e-2)
        assert len(leg["errors"]) == 20
    assert run(["eval", str(fitted)]) == 0
    assert "least determinant" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("missing.npz", None),
        ("words.csv", "a,b,c"),
        ("short.csv", "1,2,3,4"),
        ("nan.csv", "nan,0,0,1,1,1"),
    ],
)
def test_eval_refuses_what_are_no_correspondences(
    fitted: Path, capsys: pytest.CaptureFixture[str], name: str, content: str | None
) -> None:
    if content is not None:
        Path(name).write_text(content)
    assert run(["eval", str(fitted), "--held-out", name]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert name in told
