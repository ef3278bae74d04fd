"""Splitting: three children look like their parent, and stand for it between the ends only."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from morph_cases import AffineFlow, affine_flow, random_gaussians, same_bits, union

from renderer import orbit, rasterize
from splatmorph.errors import OptionError
from splatmorph.gaussians import Gaussians
from splatmorph.images.quality import psnr
from splatmorph.morph.ramps import RAMPS
from splatmorph.morph.splitting import SHARE, split, split_stretched
from splatmorph.morph.transport import COVARIANCES
from splatmorph.rendering import bounds, renderer_arrays

SOURCE = random_gaussians(60, degree=1, seed=1)
TARGET = random_gaussians(40, degree=2, seed=2)
STRETCH = AffineFlow(torch.diag(torch.tensor([1.2, 0.1, -0.5])), torch.tensor([0.1, 0, 0]))


def flat_splat(opacity: float) -> Gaussians:
    return Gaussians(
        means=torch.zeros(1, 3),
        quats=torch.tensor([[1.0, 0, 0, 0]]),
        log_scales=torch.zeros(1, 3),
        opacity_logits=torch.logit(torch.tensor([opacity])),
        sh=torch.ones(1, 1, 3),
    )


def let_through(gaussians: Gaussians, x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Seen along z, by splats whose axes are x, y and z."""
    left = torch.ones_like(x)
    for mean, scale, alpha in zip(
        gaussians.means.double(), gaussians.scales.double(), gaussians.opacities, strict=True
    ):
        distance = ((x - mean[0]) / scale[0]) ** 2 + ((y - mean[1]) / scale[1]) ** 2
        left = left * (1 - alpha * torch.exp(-0.5 * distance))
    return left


@settings(deadline=None, max_examples=30)
@given(opacity=st.floats(0.004, 0.99), axis=st.integers(0, 1))
def test_children_have_the_moments_and_the_peak_of_their_parent(opacity: float, axis: int) -> None:
    parent = flat_splat(opacity)
    children = split(parent, torch.tensor([0]), torch.tensor([axis]))
    assert len(children) == 3
    grid = torch.linspace(-6, 6, 241, dtype=torch.float64)
    x, y = torch.meshgrid(grid, grid, indexing="ij")
    theirs, its = (1 - let_through(one, x, y) for one in (children, parent))
    for weight in (x**0, x, y, x**2, y**2, x * y):
        assert math.isclose(
            (weight * theirs).sum(), (weight * its).sum(), rel_tol=1e-3, abs_tol=1e-3
        )
    assert math.isclose(theirs.max(), its.max(), rel_tol=1e-3)
    assert (theirs - its).norm() < 0.04 * its.norm()


def test_children_lie_along_the_axis_and_take_everything_else_from_their_parent() -> None:
    parents, axis = torch.tensor([7, 3]), torch.tensor([2, 0])
    children = split(SOURCE, parents, axis)
    assert len(children) == len(SOURCE) + 4
    others = torch.ones(len(SOURCE), dtype=torch.bool)
    others[parents] = False
    assert same_bits(children.select(torch.arange(60)[others]), SOURCE.select(others))
    for i, (parent, along) in enumerate(zip(parents.tolist(), axis.tolist(), strict=True)):
        three = children.select(torch.tensor([parent, 60 + i, 62 + i]))
        assert torch.equal(three.means[0], SOURCE.means[parent])
        torch.testing.assert_close(three.means.mean(0), SOURCE.means[parent])
        rotation = matrices(SOURCE)[parent]
        step = rotation.T @ (three.means[1] - three.means[0])
        across = [k for k in range(3) if k != along]
        assert step[across].abs().max() < 1e-5 * step[along].abs()
        shares = three.scales / SOURCE.scales[parent]
        torch.testing.assert_close(shares[:, along], torch.full((3,), SHARE))
        assert ((shares[:, across] > 0.97) & (shares[:, across] <= 1)).all()
        for name in ("quats", "sh"):
            assert all(
                torch.equal(one, getattr(SOURCE, name)[parent]) for one in getattr(three, name)
            )
        assert torch.equal(three.extras["segment"], SOURCE.extras["segment"][[parent] * 3])


def matrices(gaussians: Gaussians) -> torch.Tensor:
    from splatmorph.geometry.quaternions import to_matrices

    return to_matrices(gaussians.quats)


def test_only_what_is_stretched_is_split_and_as_often_as_need_be() -> None:
    axes = torch.tensor([[0.0, -3, -3], [-3, 0, -3], [-3, -3, 0]])
    aligned = replace(
        random_gaussians(3),
        quats=torch.tensor([[1.0, 0, 0, 0]]).expand(3, 4),
        log_scales=axes,
    )
    x_grows = AffineFlow(torch.diag(torch.tensor([math.log(3.0), 0.1, -1])), torch.zeros(3))
    assert split_stretched(aligned, x_grows, 1, 3.2) is aligned
    once = split_stretched(aligned, x_grows, 1, 2.5)
    assert len(once) == 5
    assert same_bits(once.select(torch.tensor([1, 2])), aligned.select(torch.tensor([1, 2])))
    # 3 · SHARE is 2.1 and 3 · SHARE² is 1.5: two rounds, each of three for one.
    assert len(split_stretched(aligned, x_grows, 1, 1.8)) == 3 + 8
    # Backwards z grows, and the third lies along it.
    back = split_stretched(aligned, x_grows, -1, 2.5)
    assert same_bits(back.select(torch.tensor([0, 1])), aligned.select(torch.tensor([0, 1])))
    assert len(back) == 5


@pytest.mark.parametrize("ramp", RAMPS)
@pytest.mark.parametrize("covariance", COVARIANCES)
def test_ends_and_beyond_are_as_without_splitting(ramp: str, covariance: str) -> None:
    plain = union(SOURCE, TARGET, STRETCH, ramp=ramp, covariance=covariance)
    morph = replace(plain, split=1.3)
    times = [-0.2, 0.0, 0.5, 1.0, 1.2]
    frames = list(morph.sequence(times))
    assert same_bits(frames[1], SOURCE)
    assert same_bits(frames[3], TARGET)
    assert len(frames[2]) > len(SOURCE) + len(TARGET)
    assert same_bits(frames[0], plain.at(-0.2))
    assert same_bits(frames[4], plain.at(1.2))


def test_the_splits_are_the_same_whatever_times_are_asked_for() -> None:
    times = [0.1, 0.5, 0.9]
    frames = list(union(SOURCE, TARGET, STRETCH, split=1.3).sequence(times))
    assert len({len(frame) for frame in frames}) == 1
    for t, frame in zip(times, frames, strict=True):
        alone = union(SOURCE, TARGET, STRETCH, split=1.3).at(t)
        assert len(alone) == len(frame)
        torch.testing.assert_close(alone.means, frame.means)


def test_stable_counts_keep_the_inputs_in_front_of_what_was_added() -> None:
    morph = union(SOURCE, TARGET, STRETCH, split=1.3, stable_count=True)
    frames = dict(zip(times := [-0.5, 0.0, 0.5, 1.0, 1.5], morph.sequence(times), strict=True))
    assert len({len(frame) for frame in frames.values()}) == 1
    assert all(frame.opacity_logits.isfinite().all() for frame in frames.values())
    n = len(SOURCE)
    for name in ("means", "quats", "log_scales", "opacity_logits"):
        assert torch.equal(getattr(frames[0.0], name)[:n], getattr(SOURCE, name))
    assert frames[0.0].opacities[n:].max() < 1 / 255
    middle = len(split_stretched(SOURCE, STRETCH, 1, 1.3))
    assert torch.equal(frames[1.0].means[middle : middle + len(TARGET)], TARGET.means)
    seen = frames[1.0].opacities > 1 / 255
    assert int(seen.sum()) == int((TARGET.opacities > 1 / 255).sum())


def test_nothing_pops_where_splits_take_over() -> None:
    # Sheets one behind the other: where splats stick in one another, as random ones do, parts
    # are drawn in another order than wholes.
    n = 300
    depth = torch.linspace(-0.5, 0.5, n)[:, None]
    turn = torch.pi * torch.rand(n, generator=torch.Generator().manual_seed(1))
    source = replace(
        random_gaussians(n),
        means=torch.cat([0.4 * random_gaussians(n).means[:, :2], depth], 1),
        quats=torch.stack([turn.cos(), 0 * turn, 0 * turn, turn.sin()], 1),
        log_scales=torch.tensor([0.2, 0.1, 0.001]).log().expand(n, 3),
        sh=random_gaussians(n, seed=4).sh,
    )
    flow = AffineFlow(torch.diag(torch.tensor([1.0, 1.0, 0.0])), torch.zeros(3))
    view = orbit(bounds(source), [0.0], width=128, height=128)[0]

    def picture(gaussians: Gaussians) -> torch.Tensor:
        arrays = renderer_arrays(gaussians)
        return torch.from_numpy(rasterize(*arrays, view.viewmat, view.K, 128, 128)[0])

    start, after = map(picture, union(source, source, flow, split=2).sequence([0.0, 1e-5]))
    assert len(union(source, source, flow, split=2).at(1e-5)) == 4 * n
    assert psnr(after, start) > 38


def test_a_flow_that_stretches_nothing_splits_nothing() -> None:
    still = AffineFlow(torch.zeros(3, 3), torch.zeros(3))
    assert len(union(SOURCE, TARGET, still, split=1.01).at(0.5)) == len(SOURCE) + len(TARGET)
    assert len(union(SOURCE, TARGET, affine_flow(), split=1e6).at(0.5)) == len(SOURCE) + len(TARGET)


@pytest.mark.parametrize("threshold", [1.0, 0.5, -2.0, math.inf, math.nan])
def test_a_threshold_of_no_use_is_refused(threshold: float) -> None:
    with pytest.raises(OptionError, match="expected a number above 1"):
        union(SOURCE, TARGET, affine_flow(), split=threshold)
