"""The container: shapes are checked, a union keeps both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from splatmorph.gaussians import UPS, Gaussians
from splatmorph.geometry.harmonics import harmonics
from splatmorph.geometry.quaternions import to_matrices
from splatmorph.geometry.similarity import Similarity

MakeGaussians = Callable[..., Gaussians]


def test_activations(make_gaussians: MakeGaussians) -> None:
    splats = make_gaussians(5, 2)
    assert splats.sh_degree == 2
    assert torch.equal(splats.scales.log().round(decimals=4), splats.log_scales.round(decimals=4))
    assert ((splats.opacities > 0) & (splats.opacities < 1)).all()


@pytest.mark.parametrize("field", ["means", "quats", "log_scales", "opacity_logits", "sh"])
def test_shapes_must_agree(make_gaussians: MakeGaussians, field: str) -> None:
    splats = make_gaussians(5)
    with pytest.raises(ValueError, match=field if field != "means" else "shape"):
        replace(splats, **{field: getattr(splats, field)[1:]})
    with pytest.raises(ValueError, match="sh has 7 coefficients"):
        replace(splats, sh=torch.zeros(5, 7, 3))


def test_a_union_keeps_both_in_order(make_gaussians: MakeGaussians) -> None:
    a = replace(make_gaussians(3, 0), extras={"label": torch.ones(3), "only": torch.ones(3)})
    b = replace(make_gaussians(4, 2, seed=1), extras={"label": torch.zeros(4)})
    both = Gaussians.union(a, b)
    assert len(both) == 7
    assert both.sh_degree == 2
    assert torch.equal(both.means, torch.cat([a.means, b.means]))
    assert torch.equal(both.sh[:3, :1], a.sh)
    assert not both.sh[:3, 1:].any()
    assert list(both.extras) == ["label"]


def test_select_takes_masks_and_indices(make_gaussians: MakeGaussians) -> None:
    splats = replace(make_gaussians(6), extras={"label": torch.arange(6)})
    mask = torch.tensor([True, False, True, False, False, True])
    assert torch.equal(splats.select(mask).extras["label"], torch.tensor([0, 2, 5]))
    assert torch.equal(splats.select(torch.tensor([5, 0])).means, splats.means[[5, 0]])


def test_the_sh_degree_can_be_cut_and_padded(make_gaussians: MakeGaussians) -> None:
    splats = make_gaussians(4, 2)
    assert splats.with_sh_degree(2) is splats
    assert torch.equal(splats.with_sh_degree(1).sh, splats.sh[:, :4])
    assert torch.equal(splats.with_sh_degree(3).with_sh_degree(2).sh, splats.sh)


def quarter_turn_about_x() -> Similarity:
    """y goes to z."""
    turn = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return Similarity(turn, 3.0, torch.tensor([1.0, 2.0, 3.0]))


def covariances(splats: Gaussians) -> torch.Tensor:
    axes = to_matrices(splats.quats.double()) * splats.scales.double()[:, None]
    return axes @ axes.mT


def test_a_similarity_moves_centers_shapes_and_colours(make_gaussians: MakeGaussians) -> None:
    splats = make_gaussians(20, 3)
    element = quarter_turn_about_x()
    moved = splats.moved(element)
    torch.testing.assert_close(moved.means, element(splats.means))
    turn = element.rotation
    torch.testing.assert_close(covariances(moved), 9 * turn @ covariances(splats) @ turn.T)
    assert torch.equal(moved.opacity_logits, splats.opacity_logits)
    direction = torch.nn.functional.normalize(torch.randn(3), dim=0)
    before, after = (
        torch.cat([harmonics(d, degree) for degree in range(4)])
        for d in (turn.T.float() @ direction, direction)
    )
    seen = torch.einsum("k,nkc->nc", before, splats.sh)
    torch.testing.assert_close(torch.einsum("k,nkc->nc", after, moved.sh), seen)


def test_moving_there_and_back_comes_back(make_gaussians: MakeGaussians) -> None:
    splats, element = make_gaussians(20, 2), quarter_turn_about_x()
    back = splats.moved(element).moved(element.inverse())
    for name in ("means", "log_scales", "sh"):
        torch.testing.assert_close(getattr(back, name), getattr(splats, name))
    torch.testing.assert_close(covariances(back), covariances(splats))
    assert splats.moved(Similarity.identity()) is splats


def test_up_turns_along_and_is_lost_between_the_axes(make_gaussians: MakeGaussians) -> None:
    element = quarter_turn_about_x()
    for up, turned in (("y", "z"), ("z", "-y"), ("-y", "-z"), ("x", "x"), (None, None)):
        splats = replace(make_gaussians(3), up=up)
        assert splats.moved(element).up == turned
        assert splats.moved(element.power(0.2)).up == up
    assert replace(make_gaussians(3), up="y").moved(element.power(0.5)).up is None
    with pytest.raises(ValueError, match="up is 'w'"):
        replace(make_gaussians(3), up="w")
    assert set(UPS) == {"x", "-x", "y", "-y", "z", "-z"}


@pytest.mark.parametrize(
    ("first", "second", "both"),
    [("z", "z", "z"), ("z", None, "z"), (None, "-y", "-y"), ("y", "z", None), (None, None, None)],
)
def test_a_union_says_what_is_up_where_none_gainsays_it(
    make_gaussians: MakeGaussians, first: str | None, second: str | None, both: str | None
) -> None:
    a, b = (replace(make_gaussians(2), up=up) for up in (first, second))
    assert Gaussians.union(a, b).up == both


def test_a_union_of_far_splats_has_one_offset(make_gaussians: MakeGaussians) -> None:
    a = replace(make_gaussians(2), offset=(480000.0, 5400000.0, 0.0))
    b = replace(make_gaussians(2, seed=1), offset=(480010.0, 5400000.0, 0.0))
    both = Gaussians.union(a, b)
    expected = torch.cat([a.absolute_means, b.absolute_means])
    torch.testing.assert_close(both.absolute_means, expected, rtol=0, atol=1e-6)
    assert torch.equal(both.means[:2], a.means)
