"""Cameras: what they see, where they stand, what they read."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from renderer import (
    ArgumentError,
    Bounds,
    bounds_of,
    camera_path,
    look_at,
    orbit,
)
from renderer.cameras import ENOUGH

SPHERE = Bounds(np.array([1.0, 2.0, -3.0]), 0.7)


def pixels_of(camera, points):
    seen = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    assert (seen[:, 2] > 0).all()
    projected = seen @ camera.K.T
    return projected[:, :2] / projected[:, 2:]


def head(n=4000, seed=0):
    rng = np.random.default_rng(seed)
    means = rng.normal(size=(n, 3))
    means *= [0.4, 0.6, 0.5] / np.linalg.norm(means, axis=1, keepdims=True)
    return means + np.array([5, 0, 0]), np.full(n, 0.9), np.full((n, 3), 0.01)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    azimuth=st.floats(-720, 720),
    elevation=st.floats(-89, 89),
    up=st.sampled_from(["y", "-y", "z", "-z"]),
    fov=st.floats(5, 120),
    size=st.sampled_from([(512, 512), (300, 200), (90, 160)]),
)
def test_an_orbit_holds_the_object_in_the_picture(azimuth, elevation, up, fov, size):
    (camera,) = orbit(
        SPHERE, [azimuth], elevation=elevation, up=up, width=size[0], height=size[1], fov=fov
    )
    R = camera.viewmat[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) > 0
    center = pixels_of(camera, SPHERE.center[None])
    np.testing.assert_allclose(center[0], np.array(size) / 2, atol=1e-6)
    rng = np.random.default_rng(0)
    rim = rng.normal(size=(500, 3))
    rim = SPHERE.center + SPHERE.radius * rim / np.linalg.norm(rim, axis=1, keepdims=True)
    pixels = pixels_of(camera, rim)
    assert (pixels > 0).all()
    assert (pixels < size).all()


@pytest.mark.parametrize(
    ("up", "front", "above"),
    [
        ("y", [0, 0, 1], [0, 1, 0]),
        ("-y", [0, 0, 1], [0, -1, 0]),
        ("z", [0, -1, 0], [0, 0, 1]),
        ("-z", [0, 1, 0], [0, 0, -1]),
    ],
)
def test_the_front_is_where_the_convention_says(up, front, above):
    front_view, side_view = orbit(SPHERE, [0, 90], up=up)
    offset = front_view.position - SPHERE.center
    np.testing.assert_allclose(offset / np.linalg.norm(offset), front, atol=1e-12)
    # What is above the center is higher in the picture: a smaller row.
    tip = SPHERE.center + 0.5 * np.array(above)
    assert pixels_of(front_view, tip[None])[0, 1] < 256
    # At +90 the camera has moved to its right.
    side = side_view.position - SPHERE.center
    assert front_view.viewmat[0, :3] @ side > 0


def test_bounds_of_a_head_and_floaters():
    means, opacities, scales = head()
    clean = bounds_of(means, opacities, scales)
    np.testing.assert_allclose(clean.center, [5, 0, 0], atol=0.05)
    assert 0.55 < clean.radius < 0.7
    rng = np.random.default_rng(1)
    floaters = rng.uniform(-20, 20, (120, 3))
    with_floaters = bounds_of(
        np.concatenate([means, floaters]),
        np.concatenate([opacities, np.full(120, 0.5)]),
        np.concatenate([scales, np.full((120, 3), 0.5)]),
    )
    np.testing.assert_allclose(with_floaters.center, clean.center, atol=0.03)
    assert with_floaters.radius == pytest.approx(clean.radius, rel=0.1)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(scale=st.floats(1e-3, 1e3), shift=st.tuples(*[st.floats(-100, 100)] * 3))
def test_bounds_move_and_scale_with_the_splat(scale, shift):
    means, opacities, scales = head(500)
    before = bounds_of(means, opacities, scales)
    after = bounds_of(scale * means + shift, opacities, scale * scales)
    np.testing.assert_allclose(after.center, scale * before.center + shift, rtol=1e-6, atol=1e-6)
    assert after.radius == pytest.approx(scale * before.radius, rel=1e-6)


def test_bounds_take_tensors_and_ignore_what_is_not_seen():
    means, opacities, scales = (torch.from_numpy(a) for a in head())
    means[0], opacities[1], means[1] = torch.nan, 0, 1e6
    assert bounds_of(means, opacities, scales).radius < 0.7
    assert bounds_of(means[5:6], opacities[5:6], scales[5:6]).radius == pytest.approx(0.02)
    with pytest.raises(ArgumentError, match="nothing to frame"):
        bounds_of(means, torch.zeros(len(means)), scales)


def test_bounds_of_very_many_are_those_of_some():
    rng = np.random.default_rng(0)
    means = rng.normal(size=(2 * ENOUGH + 7, 3)).astype(np.float32)
    alphas, scales = np.full(len(means), 0.5), np.full((len(means), 3), 0.01)
    many, some = (
        bounds_of(means[part], alphas[part], scales[part]) for part in (slice(None), slice(ENOUGH))
    )
    assert np.abs(many.center - some.center).max() < 0.02 * many.radius
    assert many.radius == pytest.approx(some.radius, rel=0.02)


def test_bounds_of_real_heads_hold_them(shared_data):
    from splatmorph import io

    for path in sorted((shared_data / "heads").glob("*.ply")):
        splat = io.read(path)
        bounds = bounds_of(splat.means, splat.opacities, splat.scales)
        inside = np.linalg.norm(splat.means.numpy() - bounds.center, axis=1) < bounds.radius
        assert inside.mean() > 0.97
        assert 0.15 < bounds.radius < 0.25


def test_a_path_runs_through_its_keys():
    keys = orbit(SPHERE, [0, 40, 100], elevation=20)
    path = camera_path(keys, 41)
    assert len(path) == 41
    for at, key in ((0, 0), (20, 1), (40, 2)):
        np.testing.assert_allclose(path[at].viewmat, keys[key].viewmat, atol=1e-9)
        np.testing.assert_allclose(path[at].K, keys[key].K)
    steps = np.linalg.norm(np.diff([camera.position for camera in path], axis=0), axis=1)
    assert steps.max() < 3 * steps.min()


def test_bad_cameras_are_refused():
    with pytest.raises(ArgumentError, match="up"):
        orbit(SPHERE, [0], up="x")
    with pytest.raises(ArgumentError, match="elevation"):
        orbit(SPHERE, [0], elevation=90)
    with pytest.raises(ArgumentError, match="fov"):
        orbit(SPHERE, [0], fov=0)
    with pytest.raises(ArgumentError, match="0x5"):
        orbit(SPHERE, [0], width=0, height=5)
    with pytest.raises(ArgumentError, match="up direction"):
        look_at([0, 1, 0], [0, 0, 0], [0, 1, 0])
    with pytest.raises(ArgumentError, match="at least 2"):
        camera_path(orbit(SPHERE, [0]), 5)
    with pytest.raises(ArgumentError, match="size"):
        camera_path([*orbit(SPHERE, [0]), *orbit(SPHERE, [9], width=64)], 5)
