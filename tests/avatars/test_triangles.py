"""Triangle frames against their NumPy twin; carrying splats there and back."""

from __future__ import annotations

import flame_twin
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from splatmorph.avatars.triangles import Frames, triangle_frames
from splatmorph.gaussians import Gaussians

SEEDS = st.integers(0, 2**32 - 1)


def _splats(count: int, seed: int, dtype: torch.dtype = torch.float64) -> Gaussians:
    made = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=made, dtype=dtype)

    return Gaussians(
        normal(count, 3), normal(count, 4), normal(count, 3), normal(count), normal(count, 4, 3)
    )


def _triangles(count: int, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    corners = np.random.default_rng(seed).normal(size=(3 * count, 3)) * 0.01 + 0.1
    return torch.from_numpy(corners), torch.arange(3 * count).view(count, 3)


def _bound(frames: Frames, splats: Gaussians) -> Gaussians:
    """Splat i on face i."""
    return frames.apply(splats, torch.arange(len(splats)))


def _rotation(quats: torch.Tensor) -> Rotation:
    return Rotation.from_quat(quats[:, [1, 2, 3, 0]].numpy())


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS)
def test_baking_agrees_with_the_twin(seed: int) -> None:
    vertices, faces = _triangles(8, seed)
    local = _splats(8, seed)
    world = _bound(triangle_frames(vertices, faces), local)
    for i in range(8):
        mean, turn, scale = flame_twin.baked(
            local.means[i].numpy(),
            local.quats[i].numpy(),
            local.log_scales[i].numpy(),
            vertices[faces[i]].numpy(),
        )
        np.testing.assert_allclose(world.means[i].numpy(), mean, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(world.scales[i].numpy(), scale, rtol=1e-10)
        # A thin triangle's normal is known to rounding over its height.
        assert (turn.inv() * _rotation(world.quats[i : i + 1])).magnitude() < 1e-9


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS)
def test_there_and_back(seed: int) -> None:
    frames = triangle_frames(*_triangles(20, seed))
    local = _splats(20, seed)
    back = _bound(frames.inverse(), _bound(frames, local))
    torch.testing.assert_close(back.means, local.means, rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(back.log_scales, local.log_scales, rtol=1e-6, atol=1e-12)
    assert (_rotation(back.quats).inv() * _rotation(local.quats)).magnitude().max() < 1e-9
    assert back.sh is local.sh
    assert back.opacity_logits is local.opacity_logits


def test_there_and_back_in_the_precision_of_a_file() -> None:
    frames = triangle_frames(*_triangles(500, 0))
    world = _bound(frames, _splats(500, 0, torch.float32))
    assert world.means.dtype == torch.float32
    again = _bound(frames, _bound(frames.inverse(), world))
    torch.testing.assert_close(again.means, world.means, rtol=1e-6, atol=1e-8)
    torch.testing.assert_close(again.log_scales, world.log_scales, rtol=1e-6, atol=1e-6)


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS)
def test_carrying_from_one_pose_to_another_is_unbinding_and_binding(seed: int) -> None:
    before = triangle_frames(*_triangles(10, seed))
    after = triangle_frames(*_triangles(10, seed + 1))
    local = _splats(10, seed)
    carried = _bound(after.after(before.inverse()), _bound(before, local))
    bound = _bound(after, local)
    torch.testing.assert_close(carried.means, bound.means, rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(carried.log_scales, bound.log_scales, rtol=1e-6, atol=1e-9)
    assert (_rotation(carried.quats).inv() * _rotation(bound.quats)).magnitude().max() < 1e-9


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS, angles=hnp.arrays(np.float64, 3, elements=st.floats(-3, 3)))
def test_frames_go_with_the_mesh(seed: int, angles: np.ndarray) -> None:
    vertices, faces = _triangles(5, seed)
    turn = torch.from_numpy(Rotation.from_rotvec(angles).as_matrix())
    shift = torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64)
    still = triangle_frames(vertices, faces)
    moved = triangle_frames(2 * vertices @ turn.T + shift, faces)
    torch.testing.assert_close(moved.rotations, turn @ still.rotations, rtol=0, atol=1e-8)
    torch.testing.assert_close(moved.scales, 2 * still.scales)
    torch.testing.assert_close(moved.centers, 2 * still.centers @ turn.T + shift)


DEGENERATE = {
    "a point": [[0.1, 0.2, 0.3]] * 3,
    "no first edge": [[0, 0, 0], [0, 0, 0], [0.01, 0, 0]],
    "a line": [[0, 0, 0], [0.01, 0, 0], [0.02, 0, 0]],
    "a line along y": [[0, 0, 0], [0, 0.01, 0], [0, -0.02, 0]],
    "no second edge": [[0, 0, 0], [0, 0, 0.01], [0, 0, 0]],
}


@pytest.mark.parametrize("corners", DEGENERATE.values(), ids=DEGENERATE.keys())
def test_degenerate_triangles_have_finite_frames(corners: list[list[float]]) -> None:
    vertices = torch.tensor(corners, dtype=torch.float64)
    frames = triangle_frames(vertices, torch.tensor([[0, 1, 2]]))
    turn = frames.rotations[0]
    torch.testing.assert_close(turn @ turn.T, torch.eye(3, dtype=torch.float64))
    assert torch.linalg.det(turn) == pytest.approx(1)
    assert frames.scales > 0
    local = _splats(1, 0)
    for splats in (_bound(frames, local), _bound(frames.inverse(), local)):
        for values in (splats.means, splats.quats, splats.log_scales):
            assert torch.isfinite(values).all()


def test_many_splats_share_a_face() -> None:
    frames = triangle_frames(*_triangles(4, 0))
    local = _splats(3, 0)
    binding = torch.tensor([2, 2, 0])
    world = frames.apply(local, binding)
    for i in range(3):
        one = frames.apply(local.select(torch.tensor([i])), binding[i : i + 1])
        torch.testing.assert_close(world.means[i : i + 1], one.means)
        torch.testing.assert_close(world.quats[i : i + 1], one.quats)
