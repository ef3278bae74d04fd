"""How sure a search may be of what it found, and what speaks against it."""

from __future__ import annotations

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from splatmorph.geometry.similarity import Similarity
from splatmorph.registration.gaps import Gap
from splatmorph.registration.matches import Partners
from splatmorph.registration.pose import Pose, rival

SURE, FAIR, DOUBTED = 0.7, 0.45, 0.44
"""Confidence from which a search is sure and fairly sure, and the most where it is doubted."""
NEIGHBOURS = 50
"""Samples whose matches speak for a point among them."""
HALF_SURE, SCATTER = 0.015, 1 / 8
"""Radii by which matches miss the flow where a point counts half; what their scatter adds to it."""
UNLIKE = 14.0
"""Score of a pose from which two splats look so unlike that surfaces alone give a start only;
read off five heads, their warps and ten ICT persons."""
ALONE, TELLING = 0.06, 0.008
"""Lead of the best pose, mean distinctness of the matches: below, they are doubted."""


def of_points(points: Tensor, partners: Partners, whole: float) -> Tensor:
    """(n,) how sure each sample's landmark is: the geometric mean of ``whole``, that of the whole
    search, and of how well the flow follows the matches round it, which miss it by their common
    part, as far as they are distinct, and by a little of what they scatter.

    Chosen on james → p2-1, persons 1, a p2-1 whose face is shrunk and the sample head of the tests.
    """
    near = cKDTree(points.numpy()).query(points.numpy(), min(NEIGHBOURS, len(points)))[1]
    offset, sure = (
        one.double()[torch.from_numpy(near)] for one in (partners.offset, partners.sure)
    )
    common = (offset * sure[..., None]).sum(1) / (sure.sum(1, keepdim=True) + 1e-4 * near.shape[1])
    miss = common.norm(dim=1) + SCATTER * offset.norm(dim=2).mean(1)
    return (whole / (1 + (miss / HALF_SURE).square())).sqrt()


def of_faces(points: Tensor, gap: Gap) -> float:
    """Of a search that faces or given landmarks hold: theirs, less what has no counterpart."""
    return float(points.mean()) * (1 - gap.alone / 2)


def of_surfaces(poses: list[Pose], distinct: float, gap: Gap) -> tuple[float, list[str]]:
    """Of a search by surfaces alone, and what speaks against it."""
    best = poses[0]
    likeness = 1 / (1 + (best.score / UNLIKE) ** 2)
    telling = min(1.0, distinct / (2 * TELLING))
    other = rival(poses)
    lead = 1.0 if other is None else min(1.0, other[1] / (2 * ALONE))
    sure = likeness * telling * lead * (1 - gap.alone / 2)
    doubts = []
    if other is not None and other[1] < ALONE:
        first, second = (in_turns(pose.similarity) for pose in (best, other[0]))
        doubts.append(
            f"two poses fit about as well: {first} (taken), and {second}; objects that look alike "
            "from several sides have no one pose: turn one by hand, or give landmarks"
        )
    if best.score > UNLIKE:
        doubts.append(
            "without a face in both, surfaces that agree as little as these are matched roughly: "
            "take this as a start and give landmarks where it is wrong"
        )
    elif distinct < TELLING:
        doubts.append(
            "next to nothing on the surfaces is distinct enough to tell what belongs together: "
            "give landmarks"
        )
    return min(sure, DOUBTED) if doubts else sure, doubts


def in_turns(similarity: Similarity) -> str:
    """A pose in words."""
    degrees = similarity.degrees
    if degrees < 0.5:
        return "as they lie"
    axis = ", ".join(f"{value:.2f}" for value in similarity.axis.tolist())
    return f"the source turned by {degrees:.0f}° about ({axis})"


def in_words(sure: float) -> str:
    """sure, fairly sure or unsure."""
    return "sure" if sure >= SURE else "fairly sure" if sure >= FAIR else "unsure"
