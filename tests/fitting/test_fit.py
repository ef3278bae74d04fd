"""fit: what it reaches, what it survives, what it says."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import torch
from torch import Tensor

from splatmorph.errors import FitError, LandmarkError, NonFiniteError, OptionError
from splatmorph.fitting import FitConfig, FitProgress, FitState, fit, objectives
from splatmorph.fitting.choice import MOST, Regression, choose
from splatmorph.fitting.train import CHECK_EVERY
from splatmorph.flows import KINDS, Flow, Ifmorph, Node, make_flow
from splatmorph.geometry.quaternions import matrices_from_axis_angles
from splatmorph.geometry.similarity import Similarity
from splatmorph.landmarks import Landmarks
from splatmorph.metrics import landmark_mse

# Other tests have flows of their own, which may be known by now.
OURS = [name for name, kind in KINDS.items() if kind.__module__.startswith("splatmorph.")]
TRAINED = (
    {"kind": "node", "field": "siren", "width": 16},
    {"kind": "ncf", "width": 8, "layers": 3},
    {"kind": "ifmorph", "width": 16},
)
trained = pytest.mark.parametrize("options", TRAINED, ids=lambda o: str(o["kind"]))
dims = pytest.mark.parametrize("dim", [2, 3])


def cloud(count: int, dim: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(count, dim, generator=generator, dtype=torch.float64) * 2 - 1


def moved(points: Tensor) -> Tensor:
    """A smooth map that stretches, turns and shifts."""
    bend = 0.15 * torch.sin(2 * points.roll(1, dims=1))
    return 1.1 * points + bend + 0.2


def pair(count: int = 30, dim: int = 3, seed: int = 0) -> tuple[Landmarks, Landmarks]:
    source = cloud(count, dim, seed)
    names = tuple(f"point {i}" for i in range(count))
    return Landmarks(source, names), Landmarks(moved(source), names)


@dims
@pytest.mark.parametrize("count", [4, 30, 300])
def test_spline_meets_its_landmarks(count: int, dim: int) -> None:
    flow = make_flow("node", dim)
    report = fit(flow, *pair(count, dim))
    assert report.mse < 1e-6
    assert report.mse < 1e-3 * report.mse_before
    assert report.det_min > 0
    assert report.status == "landmarks met"
    assert report.laws.identity == 0
    assert report.laws.inverse < 1e-4
    assert report.laws.group < 1e-4


@trained
@dims
def test_training_comes_closer(options: dict[str, object], dim: int) -> None:
    flow = make_flow(dim=dim, **options)
    report = fit(flow, *pair(dim=dim), FitConfig(steps=120))
    assert report.mse < 0.3 * report.mse_before
    assert not any(parameter.requires_grad for parameter in flow.parameters())
    if not isinstance(flow, Ifmorph):
        assert report.laws.inverse < 1e-4


@dims
def test_displacement_meets_its_landmarks_at_every_time(dim: int) -> None:
    flow = make_flow("tps", dim)
    source, target = pair(dim=dim)
    report = fit(flow, source, target, FitConfig(smoothing=0))
    assert report.mse < 1e-20


@pytest.mark.parametrize("kind", OURS)
def test_report_is_json(kind: str) -> None:
    flow = make_flow(kind)
    report = fit(flow, *pair(8), FitConfig(steps=1))
    told = json.loads(json.dumps(report.to_dict()))
    assert told["landmarks"] == 8
    assert told["laws"]["identity"] == report.laws.identity
    assert "history" not in told
    assert list(report.errors.values()) == sorted(report.errors.values(), reverse=True)


def test_moving_and_scaling_both_sides_does_the_same_to_the_flow() -> None:
    source, target = pair()
    flow, other = make_flow(), make_flow()
    fit(flow, source, target)
    shift = torch.tensor([5.0, -2.0, 1.0], dtype=torch.float64)
    fit(other, Landmarks(3 * source.points + shift), Landmarks(3 * target.points + shift))
    x = cloud(20, 3, seed=1)
    assert torch.allclose(other(3 * x + shift, 0.6), 3 * flow(x, 0.6) + shift, atol=1e-9)


def test_turning_both_sides_turns_the_flow() -> None:
    source, target = pair()
    turn = torch.linalg.qr(cloud(3, 3, seed=3))[0]
    flow, other = make_flow(), make_flow()
    fit(flow, source, target)
    fit(other, Landmarks(source.points @ turn.T), Landmarks(target.points @ turn.T))
    x = cloud(20, 3, seed=1)
    # The frame is a box along the axes, so smoothing and rounding weigh a little differently.
    assert torch.allclose(other(x @ turn.T, 0.6), flow(x, 0.6) @ turn.T, atol=2e-3)


def test_swapping_source_and_target_reverses_the_flow() -> None:
    source, target = pair()
    flow, other = make_flow(), make_flow()
    fit(flow, source, target)
    fit(other, target, source)
    x = cloud(20, 3, seed=1)
    assert torch.allclose(other(x, 0.6), flow(x, -0.6), atol=1e-9)


@trained
def test_same_seed_same_bits(options: dict[str, object]) -> None:
    states = []
    for seed in (1, 1, 2):
        flow = make_flow(**options)
        fit(flow, *pair(), FitConfig(steps=5, seed=seed))
        states.append(torch.cat([value.flatten().double() for value in flow.state_dict().values()]))
    assert torch.equal(states[0], states[1])
    assert not torch.equal(states[0], states[2])


@trained
def test_resumed_training_ends_where_it_would_have(options: dict[str, object]) -> None:
    config = FitConfig(steps=3 * CHECK_EVERY)
    whole, halves = make_flow(**options), make_flow(**options)
    fit(whole, *pair(), config)
    states: list[FitState] = []

    def stop(state: FitState) -> None:
        states.append(state)
        raise KeyboardInterrupt

    report = fit(halves, *pair(), config, on_state=stop)
    assert report.interrupted
    assert all(value.is_contiguous() for value in states[0].tensors.values())
    report = fit(halves, *pair(), config, resume=states[0])
    assert not report.interrupted
    for name, value in whole.state_dict().items():
        assert torch.equal(value, halves.state_dict()[name]), name


def test_state_of_another_flow_is_refused() -> None:
    with pytest.raises(OptionError, match="fit anew"):
        fit(make_flow("ncf"), *pair(), resume=FitState({}, {"step": "3"}))


@pytest.mark.parametrize("what", ["a moment missing", "a shape", "a type", "steps", "infinite"])
def test_a_damaged_state_is_refused_by_its_name(what: str) -> None:
    kept: list[FitState] = []
    config = FitConfig(steps=CHECK_EVERY)
    fit(make_flow("ncf"), *pair(), config, on_state=kept.append)
    tensors, meta = dict(kept[0].tensors), dict(kept[0].meta)
    if what == "a moment missing":
        del tensors["adam.0.exp_avg_sq"]
    elif what == "a shape":
        tensors["adam.0.exp_avg"] = tensors["adam.0.exp_avg"][:1]
    elif what == "a type":
        tensors["flow.drift"] = tensors["flow.drift"].int()
    elif what == "steps":
        meta["step"] = "9" * 400
    else:
        tensors["best.drift"] = torch.full_like(tensors["best.drift"], torch.inf)
    with pytest.raises(OptionError, match=r"^left\.safetensors is of another"):
        fit(make_flow("ncf"), *pair(), config, resume=FitState(tensors, meta, "left.safetensors"))


def test_interrupt_keeps_the_best_so_far() -> None:
    flow = make_flow("node", field="siren", width=16)

    def interrupt(step: FitProgress) -> None:
        if step.step >= 2 * CHECK_EVERY:
            raise KeyboardInterrupt

    report = fit(flow, *pair(), on_step=interrupt)
    assert report.interrupted
    assert report.status.startswith("interrupted")
    assert report.mse < report.mse_before


@trained
def test_non_finite_training_stops(
    options: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    flow = make_flow(**options)
    objective = {"node": "Siren", "ncf": "NCF", "ifmorph": "Ifmorph"}[flow.kind]
    monkeypatch.setattr(
        f"splatmorph.fitting.objectives.{objective}Objective.loss",
        lambda *_: torch.tensor(math.nan, requires_grad=True),
    )
    with pytest.raises(NonFiniteError, match="attempts"):
        fit(flow, *pair(), FitConfig(steps=3))


def test_thousands_of_landmarks() -> None:
    source = cloud(2500, 3)
    report = fit(make_flow(), Landmarks(source), Landmarks(moved(source)), FitConfig(steps=2))
    assert report.mse < 1e-5
    assert len(report.errors) == 2500


@dims
def test_coplanar_landmarks_are_fitted(dim: int) -> None:
    source = cloud(12, dim)
    source[:, -1] = 0.25
    target = source.clone()
    target[:, 0] *= 1.2
    flow = make_flow("node", dim)
    report = fit(flow, Landmarks(source), Landmarks(target))
    assert report.mse < 1e-6
    assert torch.isfinite(flow(cloud(20, dim, seed=2), 1.0)).all()


def test_smoothing_forgives_noise() -> None:
    source, target = pair(200)
    noise = 0.03 * torch.randn(200, 3, generator=torch.Generator().manual_seed(0))
    noisy = Landmarks(target.points + noise)
    unseen = cloud(200, 3, seed=9)
    missed = []
    for smoothing in (0.0, 0.1):
        flow = make_flow()
        fit(flow, source, noisy, FitConfig(smoothing=smoothing))
        missed.append(float((flow(unseen, 1.0) - moved(unseen)).norm(dim=1).mean()))
    assert missed[1] < 0.9 * missed[0]


def test_contradicting_landmarks_are_named() -> None:
    source, target = pair(40)
    torn = target.points.clone()
    nearby = source.points.clone()
    nearby[7] = nearby[3] + 1e-4
    torn[7] = torn[3] + 0.8
    report = fit(make_flow(), Landmarks(nearby, source.names), Landmarks(torn, source.names))
    assert any("point 3" in line and "point 7" in line for line in report.warnings)
    assert {"point 3", "point 7"} & set(list(report.errors)[:3])


def test_folding_is_told_with_its_place() -> None:
    source = cloud(40, 3)
    report = fit(make_flow("tps"), Landmarks(source), Landmarks(cloud(40, 3, seed=5)))
    assert report.det_min < 0
    assert len(report.det_min_at) == 3
    assert any("folds" in line for line in report.warnings)


def test_landmarks_in_one_point_are_refused() -> None:
    class Same(Landmarks):
        def match(self, target: Landmarks) -> tuple[Tensor, Tensor, tuple[str, ...]]:
            return self.points, target.points, ("a", "b", "c", "d")

    one = Same(torch.ones(4, 3))
    with pytest.raises(LandmarkError, match="one point"):
        fit(make_flow(), one, one)


@pytest.mark.parametrize(
    "wrong", [{"smoothing": -1.0}, {"smoothing": math.nan}, {"steps": 0}, {"energy": "third"}]
)
def test_settings_that_can_not_be_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(OptionError, match=next(iter(wrong))):
        FitConfig(**wrong)


def test_the_paper_pair(shared_data: Path) -> None:
    source, target = (
        Landmarks.read(shared_data / "landmarks3d" / f"nersemble_{i}.landmarks.json")
        for i in ("018", "032")
    )
    flow: Flow = make_flow()
    report = fit(flow, source, target)
    assert report.mse < 2e-8
    assert report.energy_first < 0.08
    assert report.det_min > 0.25
    assert isinstance(flow, Node)
    finer = make_flow(**{**flow.config(), "steps": 200})
    finer.load_state_dict(flow.state_dict())
    p, q, _ = source.match(target)
    assert landmark_mse(finer, p, q) / report.scale**2 < 2e-8


def test_landmarks_that_change_places_are_told_at_either_end() -> None:
    generator = torch.Generator().manual_seed(0)
    p = torch.rand(20, 3, generator=generator, dtype=torch.float64) * 2 - 1
    q = p + 0.05
    # Two that run through each other: no stationary flow lets them.
    p[1], q[1] = q[0] + torch.tensor([0.0, 0.0, 4e-2]), p[0] + torch.tensor([0.0, 0.0, 4e-2])
    names = tuple(f"mark {i}" for i in range(20))
    flow = make_flow("node", 3)
    report = fit(flow, Landmarks(p, names), Landmarks(q, names))
    ends = torch.stack([flow(p, 1.0) - q, flow(q, -1.0) - p]).norm(dim=2).amax(0)
    assert float(ends.max()) > 1e-2
    assert next(iter(report.errors.values())) >= float(ends.max()) * (1 - 1e-9)
    assert {"mark 0", "mark 1"} & set(list(report.errors)[:2])
    assert "of 20 landmarks missed" in report.status
    assert "worst mark" in report.status


def test_what_was_found_is_not_held_against_the_others() -> None:
    source, target = pair(40)
    points = target.points.clone()
    points[7] += torch.tensor([0.8, -0.6, 0.4])
    names = tuple(f"p{i}" for i in range(40))
    sure = torch.full((40,), 0.9)
    told = {}
    added = sure.index_fill(0, torch.tensor([7]), 1.0)
    for who, confidence in (("given", None), ("found", sure), ("added", added)):
        sides = (Landmarks(one, names, confidence) for one in (source.points, points))
        told[who] = " ".join(fit(make_flow("node", dim=3), *sides).warnings)
    assert "p7 is not where the others say" in told["given"]
    assert "p7" not in told["found"] + told["added"]


def test_a_target_that_stands_apart_is_told_and_its_frame_mends_it(
    caplog: pytest.LogCaptureFixture,
) -> None:
    source, target = pair(40)
    turn = matrices_from_axis_angles(torch.tensor([0.0, 2.6, 0.0], dtype=torch.float64))
    target = target.moved(Similarity(turn, 3.0, torch.tensor([5.0, 0.0, 0.0])))
    report = fit(make_flow("node", dim=3), source, target)
    # The pair's own warp turns and grows a little too.
    frame = source.similarity_to(target)
    assert f"stands apart as a whole (turned {frame.degrees:.0f}°" in report.warnings[-1]
    assert abs(frame.degrees - 149) < 10
    assert caplog.messages == [report.warnings[-1]]
    caplog.clear()
    report = fit(make_flow("node", dim=3), source, target.moved(frame.inverse()))
    assert not caplog.messages
    assert "apart" not in " ".join(report.warnings)


def test_landmarks_beyond_a_thousand_are_chosen_from_a_thousand(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen = []
    build = Regression.__init__
    monkeypatch.setattr(
        Regression,
        "__init__",
        lambda self, x, y, shear: seen.append(len(x)) or build(self, x, y, shear),
    )
    p = cloud(3 * MOST, 3)
    noise = 0.03 * cloud(3 * MOST, 3, seed=1)
    whole, part = choose(p, moved(p) + noise), choose(p[::3], (moved(p) + noise)[::3])
    assert max(seen) == MOST
    assert whole.smoothing == pytest.approx(part.smoothing, rel=3.1)


def test_a_conjugate_flow_that_is_too_steep_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    p = cloud(12, 2)
    ends = Landmarks(p), Landmarks(moved(p))
    config = FitConfig(steps=CHECK_EVERY)
    flow = make_flow("ncf", dim=2, width=8, layers=4)
    report = fit(flow, *ends, config)
    spline = fit(make_flow("node", dim=2), *ends)
    assert report.energy_first < objectives.TOO_STEEP * spline.energy_first
    monkeypatch.setattr(objectives, "TOO_STEEP", 1e-3)
    with pytest.raises(FitError, match="times the least that meets them"):
        fit(flow, *ends, config)
