"""Lead: the half with the stronger detail draws a place nearly alone.

The base colours of the halves agree, so no seam shows who leads, and the average of two unlike
details, which is soft, is avoided. Where the details are alike (eyes on eyes) nobody leads.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from splatmorph.gaussians import Gaussians
from splatmorph.morph.agreement.neighbours import Neighbours
from splatmorph.morph.agreement.views import Picture, View, blurred
from splatmorph.rendering import renderer_arrays

MOST = 0.85
"""The greatest lead."""
LUMINANCE = (0.299, 0.587, 0.114)
BANDS = (1.0, 2.0, 4.0)
"""Pixels of the blurs whose differences are the detail."""
WINDOW = 10.0
"""Pixels over which the strength of detail is taken."""
ALIKE = (0.2, 0.6)
"""Correlations of the details from which they begin to be alike, and are."""
CALM = 1e-5
"""Strength of detail that is none."""


def detail(picture: Picture) -> Tensor:
    """Bands of luminance (b, h, w), finest first, inside the object only."""
    inside = (picture.alpha > 0.5).float()
    luminance = torch.einsum("chw,c->hw", picture.rgb, torch.tensor(LUMINANCE))
    low, bands = luminance, []
    for sigma in BANDS:
        sums, weights = blurred(torch.stack([luminance * inside, inside]), sigma)
        lower = sums / weights.clamp_min(1e-3)
        bands.append((low - lower) * inside)
        low = lower
    return torch.stack(bands)


def odds(first: Picture, second: Picture) -> tuple[Tensor, Tensor]:
    """By how much the first's detail is stronger, log (h, w), and how much that matters.

    It doesn't at an outline, where one of them is alone, and where details are alike.
    """
    a, b = detail(first), detail(second)
    both = ((first.alpha > 0.5) & (second.alpha > 0.5)).float()
    strengths = torch.stack([*(pair.sum(0) for pair in (a * a, b * b, a * b)), both])
    own, other, mixed, near = blurred(strengths, WINDOW)
    own, other = own + CALM, other + CALM
    alike = ((mixed / (own * other).sqrt() - ALIKE[0]) / (ALIKE[1] - ALIKE[0])).clamp(0, 1)
    inner = (2 * near - 1).clamp(0, 1)
    return (own / other).log(), inner * (1 - alike)


def leads(
    parts: Sequence[Gaussians],
    views: Sequence[View],
    shown: Sequence[Sequence[Picture]],
    around: Sequence[Neighbours],
) -> list[Tensor]:
    """The lead of each splat of both parts, (n,) and (m,) in (0, 1)."""
    found = [odds(*pair) for pair in zip(*shown, strict=True)]
    told = torch.cat([by[matters > 0.25] for by, matters in found])
    # Each leads on half of the surface, however rich in detail it is.
    even = told.median() if len(told) else torch.zeros(())
    arrays = [renderer_arrays(part) for part in parts]
    sums = [torch.zeros(len(part), 2) for part in parts]
    for view, (by, matters) in zip(views, found, strict=True):
        first = 0.5 + (torch.sigmoid(2 * (by - even)) - 0.5) * matters
        for i, share in enumerate((first, 1 - first)):
            sums[i] += view.gather(arrays[i], [share, torch.ones_like(share)])
    leads = []
    for (share, total), near in zip((pair.unbind(1) for pair in sums), around, strict=True):
        mean = (share + 1e-3 * 0.5) / (total + 1e-3)
        leads.append(near.means(mean[:, None], total + 1e-3)[:, 0].clamp(1 - MOST, MOST))
    return leads
