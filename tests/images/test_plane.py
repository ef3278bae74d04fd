"""A picture as a plane of splats: both routes show the same."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scenes import fitted, painted

from renderer import Camera, rasterize
from splatmorph.gaussians import Gaussians
from splatmorph.images import FlowWarp, ImageMorph
from splatmorph.images.plane import PlaneFlow, as_splats
from splatmorph.images.quality import psnr
from splatmorph.morph import Morph

SIZE = 128
FAR = 100.0


def rendered(splats: Gaussians) -> torch.Tensor:
    """The plane from so far away that the view is parallel; the square fills the picture."""
    view = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenCV looks along +z with y down
    view[2, 3] = FAR
    focal = FAR * SIZE / 2
    intrinsics = np.array([[focal, 0, SIZE / 2], [0, focal, SIZE / 2], [0, 0, 1.0]])
    camera = Camera(view, intrinsics, SIZE, SIZE)
    rgb, alpha, _ = rasterize(
        splats.means, splats.quats, splats.scales, splats.opacities, splats.sh,
        camera.viewmat, camera.K, SIZE, SIZE,
    )  # fmt: skip
    return rgb / alpha.clamp_min(1e-3)[..., None]


def inner(picture: torch.Tensor) -> torch.Tensor:
    return picture[8:-8, 8:-8]


def test_the_splats_of_a_picture_look_like_it() -> None:
    picture = painted(SIZE, SIZE)
    wanted = torch.from_numpy(picture.as_float().pixels)
    assert psnr(inner(rendered(as_splats(picture))), inner(wanted)) > 35


def test_a_coarser_grid_has_fewer_splats() -> None:
    assert len(as_splats(painted(96, 64), columns=24)) == 24 * 16


@pytest.fixture(scope="module")
def routes() -> tuple[ImageMorph, Morph]:
    """One morph through pixels and through splats."""
    flow = fitted()
    source, target = painted(SIZE, SIZE), painted(SIZE, SIZE, seed=1)
    splats = (as_splats(source), as_splats(target))
    return (
        ImageMorph(source, target, FlowWarp(flow)),
        Morph(*splats, PlaneFlow(flow), blend="union", covariance="full"),
    )


@pytest.mark.parametrize("t", [-0.4, 1.4])
def test_both_routes_warp_alike(routes: tuple[ImageMorph, Morph], t: float) -> None:
    wanted = inner(torch.from_numpy(routes[0].at(t).pixels))
    still = inner(torch.from_numpy(routes[0].at(round(t)).pixels))
    likeness = psnr(inner(rendered(routes[1].at(t))), wanted)
    assert likeness > 33
    assert likeness > psnr(still, wanted) + 5


def test_both_routes_blend_alike(routes: tuple[ImageMorph, Morph]) -> None:
    wanted = inner(torch.from_numpy(routes[0].at(0.5).pixels))
    splats = routes[1].at(0.5)
    # All lie in one plane: who comes first is in front. The mean of both orders is neither.
    turned = splats.select(torch.arange(len(splats)).flip(0))
    orders = [inner(rendered(each)) for each in (splats, turned)]
    assert psnr((orders[0] + orders[1]) / 2, wanted) > 30


def test_the_lifted_flow_is_the_flow_beside_z() -> None:
    flow = fitted()
    lifted = PlaneFlow(flow)
    x = torch.rand(6, 3, dtype=torch.float64) - 0.5
    moved, jacobians = lifted.trajectory_jacobian(x, [0.5, -1.0])
    flat, flat_jacobians = flow.trajectory_jacobian(x[:, :2], [0.5, -1.0])
    assert torch.allclose(moved[..., :2], flat)
    assert torch.equal(moved[..., 2], x[:, 2].expand(2, 6))
    assert torch.allclose(jacobians[..., :2, :2], flat_jacobians)
    assert torch.allclose(jacobians.det(), flat_jacobians.det())
    assert torch.allclose(lifted(x, 0.5)[:, :2], flow(x[:, :2], 0.5))
    assert torch.allclose(lifted.velocity_jacobian(x).diagonal(0, 1, 2).sum(1),
                          flow.velocity_jacobian(x[:, :2]).diagonal(0, 1, 2).sum(1))  # fmt: skip
