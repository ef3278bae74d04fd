"""How good a morph is: landmark error and flow laws."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from splatmorph.flows import Flow


def landmark_mse(flow: Flow, source: Tensor, target: Tensor, times: int = 10) -> float:
    """The paper's landmark metric: mean over evenly spaced t in [0, 1] of |Φ(p,t) - Φ(q,t-1)|².

    ``source`` and ``target`` are matched (k, dim) world points. The mean is over landmarks and
    coordinates too: world units squared.
    """
    ts = torch.linspace(0, 1, times, dtype=torch.float64).tolist()
    forward = flow.trajectory(source, ts)
    backward = flow.trajectory(target, [t - 1 for t in ts])
    return float((forward - backward).square().mean())


@dataclass(frozen=True)
class FlowLaws:
    """The largest violations of a flow's laws over some points, in units of the frame's box."""

    identity: float
    """max |Φ(x, 0) - x|"""
    inverse: float
    """max |Φ(Φ(x, t), -t) - x| for t = 1/2 and 1"""
    group: float
    """max |Φ(Φ(x, s), t) - Φ(x, s + t)| for a few s, t"""


def flow_laws(flow: Flow, x: Tensor) -> FlowLaws:
    """Measure identity, inverse and group law at world points (m, dim)."""

    def gap(a: Tensor, b: Tensor) -> float:
        return float((a - b).norm(dim=1).max() / flow.scale) if len(a) else 0.0

    return FlowLaws(
        identity=gap(flow(x, 0.0), x),
        inverse=max(gap(flow(flow(x, t), -t), x) for t in (0.5, 1.0)),
        group=max(
            gap(flow(flow(x, s), t), flow(x, s + t))
            for s, t in ((0.5, 0.5), (0.3, 0.4), (1.0, -0.37))
        ),
    )
