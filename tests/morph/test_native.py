"""The C++ shapes against their plain twin."""

from __future__ import annotations

import pytest
import torch
from morph_cases import AffineFlow, random_gaussians, same_bits
from torch import Tensor

from renderer.cpp import FEWEST, plain_twins
from splatmorph.geometry.quaternions import to_matrices
from splatmorph.morph.covariance import carried_shapes
from splatmorph.morph.native import shapes
from splatmorph.morph.native.moment import moment as native_moment
from splatmorph.morph.paths import TURN, Path
from splatmorph.morph.transport import COVARIANCES, moment

COUNT = 1003
MOMENTS = 8

every_dtype = pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
every_stretch = pytest.mark.parametrize("stretch", [True, False])


def normal(*shape: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def path_of_jacobians(strength: float = 0.8) -> Tensor:
    rates = strength / MOMENTS * normal(COUNT, 3, 3, seed=0)
    return torch.stack([torch.matrix_exp(k * rates) for k in range(1, MOMENTS + 1)])


def roots(quats: Tensor, log_scales: Tensor) -> Tensor:
    rotations = to_matrices(quats.double().flatten(0, -2))
    return rotations * log_scales.double().flatten(0, -2).exp()[:, None]


@every_dtype
@every_stretch
@pytest.mark.parametrize("shape", ["needle", "pancake", "any", "ball"])
def test_native_shapes_are_the_plain_ones(shape: str, stretch: bool, dtype: torch.dtype) -> None:
    log_scales = {
        "needle": torch.tensor([[-12.0, -12, 0]]).expand(COUNT, 3),
        "pancake": torch.tensor([[-1.0, -14, -1]]).expand(COUNT, 3),
        "any": 4 * normal(COUNT, 3, seed=1),
        "ball": torch.full((COUNT, 3), -4.0),
    }[shape].to(dtype)
    quats = 3 * normal(COUNT, 4, seed=2).to(dtype)
    jacobians = path_of_jacobians().to(dtype)
    native = shapes.carried_shapes(quats, log_scales, jacobians, stretch=stretch)
    plain = carried_shapes(quats, log_scales, jacobians, stretch=stretch)
    for ours, theirs in zip(native, plain, strict=True):
        assert ours.dtype == dtype
        torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=1e-6)


@every_dtype
def test_native_needles_are_j_sigma_jt_in_every_direction(dtype: torch.dtype) -> None:
    quats = normal(COUNT, 4, seed=2).to(dtype)
    log_scales = 2 * normal(COUNT, 3, seed=1).to(dtype)
    jacobians = path_of_jacobians().to(dtype)
    found = roots(*shapes.carried_shapes(quats, log_scales, jacobians, stretch=True)[:2])
    expected = (jacobians.double() @ roots(quats, log_scales)).flatten(0, 1)
    ratio = torch.linalg.solve(expected, found)
    error = (ratio @ ratio.mT - torch.eye(3)).flatten(1).norm(dim=1)
    # A quaternion in single precision holds an axis to 1e-7, of the thickest scale.
    spread = log_scales.double().amax(1) - log_scales.double().amin(1)
    precision = 1e-7 if dtype == torch.float32 else 1e-9
    assert (error < 2e-5 + 50 * precision * spread.exp().repeat(MOMENTS)).all()


def test_native_folds_flats_and_far_scales_stay_finite() -> None:
    cases = torch.stack(
        [
            torch.diag(torch.tensor([1.0, 1, -1])),
            torch.diag(torch.tensor([1.0, 1, 0])),
            torch.zeros(3, 3),
            torch.tensor([[1, 2, 0], [0, 1, 0.5], [0, 0, 1]]),
        ]
    )[None]
    quats = normal(4, 4, seed=3).float()
    log_scales = torch.tensor([[-60.0, 0, 0], [-60, -60, 3], [1, 1, 1], [80, 0, -80]])
    native = shapes.carried_shapes(quats, log_scales, cases, stretch=True)
    assert native[0].isfinite().all()
    # What is pressed flat has a scale of 0, whose logarithm is none, or rounding.
    solid = [0, 3]
    for ours, theirs in zip(
        native, carried_shapes(quats, log_scales, cases, stretch=True), strict=True
    ):
        assert ours[:, solid].isfinite().all()
        torch.testing.assert_close(ours[:, solid], theirs[:, solid], atol=1e-5, rtol=1e-5)


def test_native_shapes_are_the_same_on_any_number_of_threads_and_strides() -> None:
    quats, log_scales = normal(COUNT, 4, seed=2).float(), normal(COUNT, 3, seed=1).float()
    jacobians = path_of_jacobians().float()
    apart = torch.zeros(MOMENTS, COUNT, 12)
    apart[..., 3:] = jacobians.flatten(2)
    apart = apart[..., 3:].unflatten(2, (3, 3))
    threads = torch.get_num_threads()
    try:
        answers = []
        for count, given in ((1, jacobians), (2, jacobians), (3, apart)):
            torch.set_num_threads(count)
            answers.append(shapes.carried_shapes(quats, log_scales, given, stretch=True))
    finally:
        torch.set_num_threads(threads)
    for one, *others in zip(*answers, strict=True):
        assert all(torch.equal(one, other) for other in others)


@pytest.mark.parametrize("covariance", COVARIANCES)
def test_splats_travel_alike_natively_and_plainly(covariance: str) -> None:
    source = random_gaussians(FEWEST + 3, degree=1)
    flow = AffineFlow(0.3 * normal(3, 3, seed=4), torch.zeros(3))
    times = [-0.4, 0.3, 1.2]

    def frames() -> list:
        frame = COVARIANCES[covariance](source, flow, times)
        return [frame(k) for k in range(len(times))]

    native = frames()
    assert same_bits(native[0], frames()[0])
    with plain_twins():
        plain = frames()
    for ours, theirs in zip(native, plain, strict=True):
        for name in ("means", "quats", "log_scales", "sh"):
            torch.testing.assert_close(
                getattr(ours, name), getattr(theirs, name), atol=1e-5, rtol=1e-5
            )


def paths_through(knots: int, **sizes: int) -> dict[str, Path]:
    """Paths that wander by chance from where ``turns`` begin."""
    paths = {}
    for name, size in sizes.items():
        start = (torch.arange(size) == 0).float().expand(COUNT, size)
        paths[name] = Path(start, start + 0.5 * normal(knots, COUNT, size, seed=size).float())
    turns = paths["turns"]
    return paths | {"turns": Path(TURN * turns.start, (TURN / 4 * turns.knots).short())}


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("drifts", [False, True])
def test_native_moments_are_the_plain_ones(degree: int, drifts: bool) -> None:
    coefficients = (degree + 1) ** 2
    paths = paths_through(4, means=3, quats=4, log_scales=3, turns=4)
    weights = torch.tensor([-0.1, 0.7, 0.5, -0.1], dtype=torch.float64)
    sh = normal(COUNT, coefficients, 3, seed=5).float()
    drift = (normal(COUNT, coefficients, 3, seed=6).float(), 0.4) if drifts else None
    for near in (4, 3):
        given = {name: Path(one.start, one.knots[:near]) for name, one in paths.items()}
        ours, theirs = (
            made(given, weights[:near], sh, degree, drift) for made in (native_moment, moment)
        )
        assert ours.keys() == theirs.keys()
        for name, expected in theirs.items():
            torch.testing.assert_close(ours[name], expected, atol=3e-5, rtol=1e-5)


def test_native_moments_without_stretch_and_on_any_number_of_threads() -> None:
    paths = paths_through(4, means=3, quats=4, turns=4)
    weights, sh = torch.full((4,), 0.25), normal(COUNT, 16, 3, seed=5).float()
    threads = torch.get_num_threads()
    try:
        answers = []
        for count in (1, 2, 3):
            torch.set_num_threads(count)
            answers.append(native_moment(paths, weights, sh, 3, None))
    finally:
        torch.set_num_threads(threads)
    assert answers[0].keys() == {"means", "quats", "sh"}
    for name, expected in answers[0].items():
        assert all(torch.equal(answer[name], expected) for answer in answers[1:])
