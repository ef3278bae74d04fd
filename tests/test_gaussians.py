"""The container: shapes are checked, a union keeps both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from splatmorph.gaussians import Gaussians

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
