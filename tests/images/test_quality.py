"""How alike two pictures are."""

from __future__ import annotations

import math

import pytest
import torch

from splatmorph.images.quality import psnr, ssim


def test_psnr_and_ssim_of_known_pictures() -> None:
    picture = torch.rand(32, 40, 3, generator=torch.Generator().manual_seed(0))
    assert psnr(picture, picture) == math.inf
    assert psnr(picture * 0, picture * 0 + 0.1) == pytest.approx(20)
    assert ssim(picture, picture) == pytest.approx(1)
    assert 0 < ssim(picture, 0.8 * picture + 0.1) < 1
    assert (
        abs(ssim(picture, torch.rand(32, 40, 3, generator=torch.Generator().manual_seed(1)))) < 0.2
    )
    with pytest.raises(ValueError, match="one shape"):
        ssim(picture, picture[1:])
