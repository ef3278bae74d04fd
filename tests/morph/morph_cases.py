"""Splats and flows with known answers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor

from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians
from splatmorph.morph import Morph

union = partial(Morph, blend="union")
"""The paper's: halves as they are, whose every splat has an answer that is known."""


class AffineFlow(Flow):
    """x ↦ e^{tA} x + ∫ e^{τA} b dτ: the flow of v(x) = A x + b, exact by matrix exponential."""

    def __init__(self, matrix: Tensor, offset: Tensor) -> None:
        super().__init__(3)
        augmented = torch.zeros(4, 4, dtype=torch.float64)
        augmented[:3, :3] = matrix
        augmented[:3, 3] = offset
        self.register_buffer("augmented", augmented)
        self.calls = 0

    def trajectory_jacobian(self, x: Tensor, times: Sequence[float]) -> tuple[Tensor, Tensor]:
        self.calls += 1
        steps = torch.tensor(times, dtype=torch.float64)[:, None, None]
        maps = torch.matrix_exp(steps * self.augmented).to(x)
        linear, shift = maps[:, :3, :3], maps[:, :3, 3]
        path = torch.einsum("tij,nj->tni", linear, x) + shift[:, None]
        return path, linear[:, None].expand(-1, len(x), -1, -1)

    def trajectory(self, x: Tensor, times: Sequence[float]) -> Tensor:
        return self.trajectory_jacobian(x, times)[0]


def random_gaussians(n: int, degree: int = 0, seed: int = 0) -> Gaussians:
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    return Gaussians(
        means=normal(n, 3),
        quats=3 * normal(n, 4),
        log_scales=normal(n, 3) - 3,
        opacity_logits=4 * normal(n),
        sh=normal(n, (degree + 1) ** 2, 3),
        extras={"segment": torch.arange(float(n))},
    )


def same_bits(a: Gaussians, b: Gaussians) -> bool:
    fields = ("means", "quats", "log_scales", "opacity_logits", "sh")
    return (
        all(torch.equal(getattr(a, name), getattr(b, name)) for name in fields)
        and a.extras.keys() == b.extras.keys()
        and all(torch.equal(a.extras[name], b.extras[name]) for name in a.extras)
    )


def affine_flow() -> AffineFlow:
    matrix = torch.tensor([[0.2, -0.5, 0.1], [0.4, -0.1, 0.3], [0.0, 0.2, 0.3]])
    return AffineFlow(matrix, torch.tensor([0.3, -0.2, 0.1]))
