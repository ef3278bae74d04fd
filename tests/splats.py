"""Splats for tests."""

from __future__ import annotations

import torch

from splatmorph.gaussians import Gaussians


def random_gaussians(n: int = 50, degree: int = 1, seed: int = 0) -> Gaussians:
    """n splats in a unit ball, small, of every opacity."""
    rng = torch.Generator().manual_seed(seed)
    return Gaussians(
        means=torch.rand(n, 3, generator=rng) * 2 - 1,
        quats=torch.randn(n, 4, generator=rng),
        log_scales=torch.randn(n, 3, generator=rng) * 0.5 - 3.5,
        opacity_logits=torch.randn(n, generator=rng) * 3,
        sh=torch.randn(n, (degree + 1) ** 2, 3, generator=rng) * 0.3,
    )
