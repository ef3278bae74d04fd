"""How alike two pictures are: PSNR and SSIM."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import conv2d


def psnr(a: Tensor, b: Tensor) -> float:
    """Peak signal-to-noise ratio in dB of two pictures of one shape, values in [0, 1]."""
    mse = float((a.double() - b.double()).square().mean())
    return math.inf if mse == 0 else -10 * math.log10(mse)


def ssim(a: Tensor, b: Tensor) -> float:
    """Structural similarity (Wang et al. 2004) of two pictures (H, W, C), values in [0, 1].

    Gaussian window of 11 pixels, σ = 1.5, over the pixels where the window fits; 1 for equals.
    """
    if a.shape != b.shape or min(a.shape[:2]) < 11:
        raise ValueError(f"pictures are {tuple(a.shape)} and {tuple(b.shape)}, expected one shape")
    offsets = torch.arange(11, dtype=torch.float64) - 5
    weights = torch.exp(-offsets.square() / (2 * 1.5**2))
    window = torch.outer(weights, weights)
    window = (window / window.sum())[None, None]
    x, y = (picture.double().cpu().movedim(-1, 0)[:, None] for picture in (a, b))

    def blur(picture: Tensor) -> Tensor:
        return conv2d(picture, window)

    mean_x, mean_y = blur(x), blur(y)
    var_x, var_y = blur(x * x) - mean_x**2, blur(y * y) - mean_y**2
    covariance = blur(x * y) - mean_x * mean_y
    c1, c2 = 0.01**2, 0.03**2
    likeness = (2 * mean_x * mean_y + c1) * (2 * covariance + c2)
    return float((likeness / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))).mean())
