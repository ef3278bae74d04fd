"""Blends: one picture from two that are aligned."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from scipy.fft import dctn, idctn
from torch import Tensor

Blend = Callable[[Tensor, Tensor, float], Tensor]
"""(source, target, t) -> picture: planes (c, h, w) float32 in [0, 1], premultiplied, both warped
to time t. Whoever morphs in the space of a generative model (DiffMorpher's attention and latents,
say) gives such a function to ``ImageMorph``; at t = 0 and 1 it is not called."""

SPREAD = 1 / 64
"""How far the gradient-domain blend leaves the linear one's brightness, in longer sides."""


def linear(source: Tensor, target: Tensor, t: float) -> Tensor:
    """(1 - t) · source + t · target."""
    return torch.lerp(source, target, t)


def poisson(source: Tensor, target: Tensor, t: float) -> Tensor:
    """The picture whose gradients are, pixel by pixel, the stronger of the two pictures'.

    Minimises Σ|∇u - g|² + ε Σ|u - m|², where m is the linear blend, which decides how bright a
    region is, and g the gradient of the source or of the target, whichever is longer over all
    channels once weighted by 1 - t and t: an edge of one picture stays crisp where the other
    has none (the mixed gradients of Pérez et al. 2003, eq. 12, for a morph). 1/√ε is ``SPREAD``
    of the longer side: larger lets the contrasts of both pictures add up to haloes.

    With no borders but the frame's, cosines diagonalise the sparse system (ε - Δ) u = ε m - div g
    (Neumann), so it is solved exactly in O(n log n).
    """
    weight = (SPREAD * max(source.shape[1:])) ** -2
    mean = linear(source, target, t)
    gradients = [_gradient(picture) for picture in (source, target)]
    strength = [
        share * torch.cat(gradient).norm(dim=0)
        for share, gradient in zip((1 - t, t), gradients, strict=True)
    ]
    keep_source = strength[0] >= strength[1]
    right, down = (torch.where(keep_source, a, b) for a, b in zip(*gradients, strict=True))
    return solve_screened(mean, right, down, weight).clamp_(0, 1)


def solve_screened(values: Tensor, right: Tensor, down: Tensor, weight: float) -> Tensor:
    """The u (c, h, w) that minimises Σ|∇u - (right, down)|² + weight · Σ|u - values|².

    ``right`` and ``down`` (c, h, w) are forward differences; those across the last column and
    the last row don't exist and are ignored.
    """
    divergence = torch.zeros_like(values)
    divergence[..., :-1] += right[..., :-1]
    divergence[..., 1:] -= right[..., :-1]
    divergence[..., :-1, :] += down[..., :-1, :]
    divergence[..., 1:, :] -= down[..., :-1, :]
    _, height, width = values.shape
    eigenvalues = weight + _laplacian(height)[:, None] + _laplacian(width)[None, :]
    right_side = (weight * values - divergence).numpy()
    solved = np.empty_like(right_side)
    for channel, plane in enumerate(right_side):
        spectrum = dctn(plane, norm="ortho", workers=-1)
        spectrum /= eigenvalues
        solved[channel] = idctn(spectrum, norm="ortho", workers=-1, overwrite_x=True)
    return torch.from_numpy(solved)


def _gradient(picture: Tensor) -> tuple[Tensor, Tensor]:
    right, down = torch.zeros_like(picture), torch.zeros_like(picture)
    torch.sub(picture[..., 1:], picture[..., :-1], out=right[..., :-1])
    torch.sub(picture[..., 1:, :], picture[..., :-1, :], out=down[..., :-1, :])
    return right, down


def _laplacian(count: int) -> np.ndarray:
    # Eigenvalues of -Δ on `count` pixels with free ends, in the order of the cosine transform.
    return (2 - 2 * np.cos(np.pi * np.arange(count) / count)).astype(np.float32)
