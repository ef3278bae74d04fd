"""Which way up a splat stands: what its file says, else what its shape suggests."""

from __future__ import annotations

from torch import Tensor

from splatmorph.gaussians import FAINTEST_DRAWN, Gaussians
from splatmorph.registration.face_network import FaceNetwork
from splatmorph.registration.faces import upright_face

ENDS = 0.1
"""The part of the height at each end whose widths are compared."""
WIDER = 2.0
"""How many times wider an end must be to be the foot: statues and busts have 2 to 5, heads that
stand upright none at their crown."""

ENOUGH = 200_000
"""Of more splats than so many, evenly picked ones tell how wide all are."""


def standing_way(gaussians: Gaussians, network: FaceNetwork | None = None) -> tuple[str, str]:
    """The axis that is likely up, and why, in a few words.

    Where the file doesn't say, it is the axis along which a face stands, if the ``network`` sees
    one; else y, but -y where the object would stand on its head, for things stand on their wider
    end. Where the mass lies tells nothing: crowns have more splats.
    """
    if gaussians.up is not None:
        return gaussians.up, "its file says so"
    if network is not None and (face := upright_face(gaussians, network)) is not None:
        return face[0], "nothing says so, but its face stands upright so"
    low, high = _widths(gaussians)
    if high > WIDER * low:
        return "-y", "nothing says so, but it is far wider at +y, and things stand on that end"
    return "y", "nothing says so, it is the custom"


def _widths(gaussians: Gaussians) -> tuple[float, float]:
    """How wide the visible splats are spread at the lowest and the highest y."""
    some = gaussians.select(slice(None, None, 1 + len(gaussians) // ENOUGH))
    seen = some.select(some.opacities >= FAINTEST_DRAWN)
    if len(seen) < 2:
        return 0.0, 0.0
    scales = seen.scales.sort(dim=1).values
    weights = (seen.opacities * scales[:, 1] * scales[:, 2]).double()
    weights = weights.clamp_max(4 * float(weights.median()))
    points = seen.means.double()
    order = points[:, 1].argsort()
    mass, height = weights[order].cumsum(0) / weights.sum(), points[order, 1]
    foot, head = (height[int((mass >= q).nonzero()[0])] for q in (0.01, 0.99))
    place = (points[:, 1] - foot) / (head - foot).clamp_min(1e-300)
    low, high = (_spread(points[end], weights[end]) for end in (place < ENDS, place > 1 - ENDS))
    return low, high


def _spread(points: Tensor, weights: Tensor) -> float:
    level, share = points[:, [0, 2]], weights[:, None] / weights.sum()
    middle = (share * level).sum(0)
    return float((share * (level - middle).square()).sum().sqrt())
