"""Pictures and flows that the tests of images share."""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from torch import Tensor

from splatmorph.fitting import fit
from splatmorph.flows import Flow, make_flow
from splatmorph.images import Canvas, Picture
from splatmorph.landmarks import Landmarks


def painted(width: int = 96, height: int = 64, channels: int = 3, seed: int = 0) -> Picture:
    """Smooth coloured blobs, 8 bit."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((height, width, channels))
    smooth = gaussian_filter(noise, (4, 4, 0), mode="reflect")
    low, high = smooth.min((0, 1)), smooth.max((0, 1))
    return Picture(((smooth - low) / (high - low) * 255).astype(np.uint8))


def ruled(width: int, height: int) -> Picture:
    """A ramp along x in red, along y in green: a pixel says where it was read."""
    x, y = np.meshgrid(np.linspace(0, 1, width), np.linspace(0, 1, height))
    return Picture(np.stack([x, y, np.zeros_like(x)], axis=-1).astype(np.float32))


class Turn(Flow):
    """Rotation about the origin by ``angle`` radians a unit of t, exactly."""

    kind = "turn"

    def __init__(self, angle: float) -> None:
        super().__init__(2)
        self.angle = angle

    def unit_forward(self, u: Tensor, t: float | Tensor) -> Tensor:
        return self.unit_trajectory(u, [float(t)], jacobian=False)[0][0]

    def unit_trajectory(
        self, u: Tensor, times: list[float], *, jacobian: bool
    ) -> tuple[Tensor, Tensor | None]:
        turned = []
        for t in times:
            c, s = math.cos(self.angle * t), math.sin(self.angle * t)
            turned.append(u @ torch.tensor([[c, s], [-s, c]], dtype=u.dtype))
        return torch.stack(turned), None


def some_landmarks(
    count: int = 20, move: float = 0.08, seed: int = 0
) -> tuple[Landmarks, Landmarks]:
    """Scattered points and a smooth motion of them."""
    rng = torch.Generator().manual_seed(seed)
    p = torch.rand(count, 2, generator=rng, dtype=torch.float64) * 1.4 - 0.7
    q = p + move * torch.stack([torch.sin(2 * p[:, 1]), torch.cos(3 * p[:, 0])], dim=1)
    return Landmarks(p), Landmarks(q)


def fitted(move: float = 0.08) -> Flow:
    """The spline flow of ``some_landmarks``."""
    flow = make_flow("node", dim=2)
    fit(flow, *some_landmarks(move=move))
    return flow


SQUARE = Canvas(64, 64)
