"""The rasterizer against its float64 twin, on both paths, and its laws."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_scenes import assert_same_picture, pinhole, random_scene

from renderer import ArgumentError, native, rasterize, rasterize_reference
from renderer.cpp import plain_twins

pytestmark = pytest.mark.usefixtures("each_path")

PER_EXAMPLE = settings(
    max_examples=10,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def check(scene, camera, **options):
    found = rasterize(**scene, **camera, **options)
    assert_same_picture(found, rasterize_reference(**scene, **camera, **options))
    return found


@PER_EXAMPLE
@given(
    n=st.integers(1, 60),
    degree=st.integers(0, 4),
    seed=st.integers(0, 10_000),
    size=st.sampled_from([(1, 1), (17, 33), (64, 64), (65, 15), (100, 3)]),
    spread=st.sampled_from([0.05, 1.0, 3.0]),
)
def test_random_scenes_equal_the_reference(n, degree, seed, size, spread):
    check(random_scene(n, degree, seed, spread), pinhole(*size), background=(0.2, 0.5, 1.0))


@pytest.mark.parametrize("size", [(1, 1), (17, 33), (1000, 3), (3, 200), (130, 129)])
def test_odd_sizes(size):
    check(random_scene(40, 1, 7), pinhole(*size))


def test_across_the_near_plane_behind_and_beside():
    scene = random_scene(200, 0, 3, spread=4.0)
    scene["means"][:50, 2] = np.linspace(-4.05, -3.9, 50)  # the camera is at z = -4
    check(scene, pinhole(96, 64))


def test_far_splats_are_not_drawn():
    scene = random_scene(50, 0, 4)
    _, alpha, _ = check(scene, pinhole(32, 32), far=3.5)
    everything = rasterize(**scene, **pinhole(32, 32))[1]
    assert alpha.sum() < everything.sum()
    assert rasterize(**scene, **pinhole(32, 32), near=100.0)[0].max() == 0


def test_huge_and_needle_thin():
    scene = random_scene(40, 0, 5)
    scene["scales"][:10] = 50.0
    scene["scales"][10:30] = [5.0, 1e-5, 1e-5]
    scene["scales"][30:] = [3.0, 0.01, 1e-4]
    check(scene, pinhole(80, 70))


def test_thousands_on_one_pixel():
    scene = random_scene(3000, 0, 6)
    scene["means"][:] = [0.01, 0.02, 0.0]
    scene["means"][:, 2] += np.linspace(0, 1e-3, 3000, dtype=np.float32)
    scene["scales"][:] = 1e-4
    scene["opacities"][:] = 0.02
    check(scene, pinhole(9, 9))


def test_splats_of_one_depth_stay_in_order():
    scene = random_scene(30, 0, 8)
    scene["means"][:, 2] = 0
    check(scene, pinhole(40, 40))


def test_nothing_to_see_is_background():
    transparent = random_scene(30, 2, 9)
    transparent["opacities"][:] = 0
    for scene in (random_scene(0, 2, 9), transparent):
        rgb, alpha, depth = rasterize(**scene, **pinhole(33, 20), background=(0.1, 0.2, 0.3))
        np.testing.assert_array_equal(rgb, np.broadcast_to(np.float32([0.1, 0.2, 0.3]), rgb.shape))
        assert not alpha.any()
        assert not depth.any()


def test_broken_splats_are_not_drawn():
    scene = random_scene(60, 0, 10)
    whole = {name: values[:50].copy() for name, values in scene.items()}
    scene["means"][50] = np.nan
    scene["means"][51] = np.inf
    scene["scales"][52] = np.inf
    scene["scales"][53] = np.nan
    scene["quats"][54] = 0
    scene["quats"][55] = np.nan
    scene["opacities"][56] = np.nan
    scene["opacities"][57] = -1
    scene["means"][58] = 1e30
    scene["opacities"][59] = np.inf
    found = rasterize(**scene, **pinhole(50, 50))
    for a, b in zip(found, rasterize(**whole, **pinhole(50, 50)), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_broken_colour_is_black():
    scene = random_scene(1, 0, 11)
    scene["means"][:] = 0
    scene["sh"][:] = np.nan
    rgb, alpha, _ = rasterize(**scene, **pinhole(9, 9))
    assert not rgb.any()
    assert alpha.any()


def test_lower_degrees_and_off_center_principal_point():
    camera = pinhole(60, 40)
    camera["K"][:2, 2] = [5.0, 33.5]
    scene = random_scene(80, 3, 12)
    for degree in range(4):
        check(scene, camera, sh_degree=degree)


def test_a_turned_camera():
    scene = random_scene(80, 3, 13)
    camera = pinhole(48, 48)
    c, s = np.cos(0.7), np.sin(0.7)
    camera["viewmat"] = camera["viewmat"] @ np.array(
        [[c, 0, s, 0.1], [0, 1, 0, -0.2], [-s, 0, c, 0.3], [0, 0, 0, 1]]
    )
    check(scene, camera)


def test_any_number_of_threads_gives_the_same_bits():
    scene = random_scene(3000, 3, 14)
    pictures = [rasterize(**scene, **pinhole(200, 150), threads=k) for k in (1, 2, 3, 5)]
    for picture in pictures[1:]:
        for a, b in zip(pictures[0], picture, strict=True):
            np.testing.assert_array_equal(a, b)


def test_short_lists_change_nothing(small_lists):
    scene = random_scene(1500, 1, 15)
    scene["scales"][::10] = 10.0  # these cover every tile
    scene["opacities"][:] *= 0.3
    whole = rasterize(**scene, **pinhole(150, 140))
    small_lists(1000)
    for a, b in zip(rasterize(**scene, **pinhole(150, 140)), whole, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


def test_crowded_scene_with_occlusion_equals_the_reference():
    scene = random_scene(1200, 0, 16, spread=0.6)
    scene["opacities"][:] = np.clip(scene["opacities"] * 4, 0, 1)
    scene["scales"][:] = np.minimum(scene["scales"] * 2, 0.5)
    check(scene, pinhole(40, 40, 3.0))


def test_a_batch_is_its_pictures():
    scene = random_scene(100, 1, 17)
    cameras = [pinhole(40, 30, distance) for distance in (3.0, 4.0, 5.0)]
    viewmats = np.stack([camera["viewmat"] for camera in cameras])
    rgb, alpha, depth = rasterize(**scene, viewmat=viewmats, K=cameras[0]["K"], width=40, height=30)
    assert rgb.shape == (3, 30, 40, 3)
    assert alpha.shape == depth.shape == (3, 30, 40)
    for i, camera in enumerate(cameras):
        np.testing.assert_array_equal(rgb[i], rasterize(**scene, **camera)[0])


def test_torch_in_torch_out():
    scene = random_scene(50, 1, 18)
    tensors = {name: torch.from_numpy(values) for name, values in scene.items()}
    tensors["means"].requires_grad_()
    found = rasterize(**tensors, **pinhole(20, 20))
    for a, b in zip(found, rasterize(**scene, **pinhole(20, 20)), strict=True):
        assert isinstance(a, torch.Tensor)
        np.testing.assert_array_equal(a.numpy(), b)


def test_any_memory_layout_is_read():
    scene = random_scene(50, 1, 19)
    odd = {name: np.asfortranarray(values.astype(np.float64)) for name, values in scene.items()}
    np.testing.assert_array_equal(
        rasterize(**odd, **pinhole(20, 20))[0], rasterize(**scene, **pinhole(20, 20))[0]
    )


def test_depth_of_one_splat_is_its_distance():
    scene = random_scene(1, 0, 20)
    scene["means"][:] = 0
    _, alpha, depth = rasterize(**scene, **pinhole(21, 21, 3.0))
    np.testing.assert_allclose(depth[alpha > 0], 3.0, rtol=1e-4)
    assert not depth[alpha == 0].any()


@PER_EXAMPLE
@given(
    n=st.integers(1, 60),
    seed=st.integers(0, 10_000),
    size=st.sampled_from([(1, 1), (17, 33), (64, 65), (100, 3)]),
    share=st.sampled_from([0.05, 0.3, 0.5, 0.99]),
)
def test_the_surface_is_where_a_share_of_the_alpha_is_gathered(n, seed, size, share):
    scene = random_scene(n, 0, seed)
    expected = rasterize(**scene, **pinhole(*size))
    found = rasterize(**scene, **pinhole(*size), depth="surface", surface_share=share)
    for a, b in zip(found[:2], expected[:2], strict=True):
        np.testing.assert_array_equal(a, b)
    wanted = rasterize_reference(**scene, **pinhole(*size), depth="surface", surface_share=share)
    # One splat or the next, where the share is reached within rounding.
    wrong = np.abs(found[2] - wanted[2]) > 1e-4 * np.maximum(wanted[2], 1)
    assert wrong.sum() <= max(1, 2e-3 * wrong.size)
    assert not found[2][found[1] == 0].any()


def test_the_surface_lies_before_the_haze():
    wall = random_scene(1, 0, 22)
    wall["means"][:], wall["scales"][:], wall["opacities"][:] = 0, 9.0, 0.6
    haze = random_scene(200, 0, 23)
    haze["means"][:, 2] = np.linspace(1, 20, 200)
    scene = {name: np.concatenate([wall[name], haze[name]]) for name in wall}
    _, alpha, mean = rasterize(**scene, **pinhole(16, 16))
    surface = rasterize(**scene, **pinhole(16, 16), depth="surface")[2]
    np.testing.assert_allclose(surface[alpha > 0], 4.0, rtol=1e-5)
    assert mean.max() > 4.5


def test_short_lists_leave_the_surface(small_lists):
    scene = random_scene(1500, 1, 24)
    scene["scales"][::10] = 10.0
    scene["opacities"][:] *= 0.3
    whole = rasterize(**scene, **pinhole(150, 140), depth="surface")[2]
    small_lists(1000)
    np.testing.assert_array_equal(
        rasterize(**scene, **pinhole(150, 140), depth="surface", threads=1)[2], whole
    )


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"means": np.zeros((5, 2))}, "means"),
        ({"quats": np.zeros((4, 4))}, "quats"),
        ({"opacities": np.zeros((5, 1))}, "opacities"),
        ({"sh": np.zeros((5, 3, 3))}, "sh has shape"),
        ({"means": "splats"}, "means"),
        ({"viewmat": np.eye(3)}, "viewmat"),
        ({"viewmat": np.full((4, 4), np.nan)}, "finite"),
        ({"viewmat": np.zeros((4, 4))}, "singular"),
        ({"viewmat": np.stack([np.eye(4)] * 3), "K": np.stack([np.eye(3)] * 2)}, "3 viewmats"),
        ({"K": np.zeros((3, 3))}, "focal"),
        ({"width": 0}, "0x8"),
        ({"height": 100_000}, "100000"),
        ({"near": -1.0}, "near"),
        ({"near": 2.0, "far": 1.0}, "far"),
        ({"background": (1, 2)}, "background"),
        ({"sh_degree": 2}, "sh_degree"),
        ({"threads": 0}, "threads"),
        ({"depth": "nearest"}, "depth"),
        ({"depth": "surface", "surface_share": 1.0}, "surface_share"),
        ({"device": "tpu"}, "device"),
        ({"device": "cuda:99"}, "device"),
    ],
)
def test_bad_arguments_are_named(change, found):
    with pytest.raises(ArgumentError, match=found):
        rasterize(**{**random_scene(5, 0, 0), **pinhole(8, 8), **change})


def test_the_native_path_is_used(each_path, monkeypatch):
    called = []
    monkeypatch.setattr(native, "render", lambda *a: called.append(1) or [np.zeros((1, 1, 1))] * 3)
    rasterize(**random_scene(5, 0, 0), **pinhole(1, 1))
    assert bool(called) == (each_path == "native")


def test_cuda_equals_the_reference():
    import warp as wp

    if not wp.is_cuda_available():
        pytest.skip("no CUDA device here")
    scene = random_scene(300, 3, 21)
    found = rasterize(**scene, **pinhole(130, 70), device="cuda:0")
    assert_same_picture(found, rasterize_reference(**scene, **pinhole(130, 70)))


def test_kernels_compile_for_cuda(tmp_path, each_path):
    import warp as wp

    from renderer import kernels

    if each_path == "native":
        pytest.skip("the native path is for CPUs only")
    try:
        files = wp.compile_aot_module(kernels, arch=80, use_ptx=True, module_dir=tmp_path)
    except RuntimeError as error:  # Warp was built without NVIDIA's compiler library
        pytest.skip(f"no CUDA compiler here: {error}")
    ptx = files[0].read_text()
    for kernel in ("project", "count_tiles", "list_tiles", "find_ranges", "blend", "finish"):
        assert f".entry {kernel}_" in ptx


def test_a_picture_that_no_cache_holds():
    scene, camera = random_scene(200, 1, 21), pinhole(1040, 1024)
    with plain_twins():
        expected = rasterize(**scene, **camera, background=(0.1, 0.2, 0.3))
    assert_same_picture(rasterize(**scene, **camera, background=(0.1, 0.2, 0.3)), expected)
