"""What a flow does to splats: centers travel, and shape and shading with them if asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import torch

from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians

Frames = Callable[[int], Gaussians]
Transport = Callable[[Gaussians, Flow, Sequence[float]], Frames]


@torch.no_grad()
def move_centers(gaussians: Gaussians, flow: Flow, times: Sequence[float]) -> Frames:
    """The paper's transport: centers follow the flow, covariance and colour stay as they are."""
    path = flow.trajectory(gaussians.means, times)
    return lambda k: replace(gaussians, means=path[k])


COVARIANCES: Mapping[str, Transport] = MappingProxyType({"fixed": move_centers})
"""By name, what travels. Each maps splats, a flow and k times to a function of 0 … k-1 that
gives the splats at that time, after one integration for all of them."""
