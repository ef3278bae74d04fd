"""Landmarks from a head's mesh: every avatar of the topology has the same ones, by name."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from splatmorph.avatars.stand_ins import as_array
from splatmorph.avatars.unpickle import load_object_array
from splatmorph.errors import OptionError, ReadError
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.spreading import farthest
from splatmorph.landmarks import Landmarks

LANDMARK_SETS = ("70", "254", "dense")

EMBEDDED = ("faces_idx", "bary_coords")
EYES = ("right_eye", "left_eye")
IBUG_POINTS = 68

NEAR_EDGES = 2.0
"""A splat is near a vertex within this many median edges of the mesh: 7 mm on a head."""
VISIBLE = 0.1
"""Opacity from which a splat shows that the avatar has a surface there."""


def mesh_landmarks(
    chosen: str, vertices: Tensor, faces: Tensor, gaussians: Gaussians, embedding: Path | None
) -> Landmarks:
    """The landmarks of one posed head.

    Vertices are named ``flame_<number>``, the 68 iBUG points ``ibug_<number>`` from 0, and the
    eye centers ``right_eye`` and ``left_eye``, the person's own.

    Arguments:
        chosen: ``70`` (iBUG and eyes), ``254`` (the paper's vertices) or ``dense`` (every vertex
            with a visible splat near it; see ``thin``).
        vertices, faces: the mesh (V, 3), (F, 3).
        gaussians: the splats in the same pose.
        embedding: the file of the 70; the others need none.

    Raises:
        OptionError: ``chosen`` is none of these.
        ReadError: the file of the 70 is damaged or of another mesh.
    """
    if chosen == "70" and embedding is not None:
        return _embedded(embedding, vertices, faces)
    if chosen == "254":
        return _at_vertices(torch.tensor(paper_vertices()), vertices)
    if chosen == "dense":
        return _at_vertices(_covered(vertices, faces, gaussians), vertices)
    raise OptionError(f"landmark set '{chosen}' is not one of: {', '.join(LANDMARK_SETS)}")


def paper_vertices() -> list[int]:
    """The FLAME vertices of the paper's experiments, 250 distinct of 254 listed, ascending."""
    stored = resources.files(__package__).joinpath("flame_vertices_254.json").read_text("utf-8")
    return sorted(
        {vertex for region in json.loads(stored)["regions"].values() for vertex in region}
    )


def thin(source: Landmarks, target: Landmarks, count: int = 500) -> tuple[Landmarks, Landmarks]:
    """The matched pairs of two sets, at most ``count``, spread evenly over both objects.

    Farthest-point sampling of the pairs (p, q) as points of one space: the same choice for both
    sides, and the same whichever is the source.

    Raises:
        OptionError: ``count`` is below 4, the fewest that a flow is fitted on.
        LandmarkError: the sets don't match, see ``Landmarks.match``.
    """
    if count < 4:
        raise OptionError(f"{count} landmarks are too few to fit a flow, expected at least 4")
    p, q, names = source.match(target)
    kept = torch.from_numpy(np.sort(farthest(torch.cat([p, q], dim=1).numpy(), count)))
    chosen = tuple(names[i] for i in kept.tolist())
    return Landmarks(p[kept], chosen), Landmarks(q[kept], chosen)


def _at_vertices(chosen: Tensor, vertices: Tensor) -> Landmarks:
    return Landmarks(vertices[chosen], tuple(f"flame_{vertex}" for vertex in chosen.tolist()))


def _covered(vertices: Tensor, faces: Tensor, gaussians: Gaussians) -> Tensor:
    from scipy.spatial import cKDTree

    edges = vertices[faces[:, 1]] - vertices[faces[:, 0]]
    reach = NEAR_EDGES * float(torch.linalg.vector_norm(edges, dim=1).median())
    visible = gaussians.means[gaussians.opacities > VISIBLE].double()
    away, _ = cKDTree(visible.numpy()).query(vertices.numpy(), distance_upper_bound=reach)
    return torch.from_numpy(away <= reach).nonzero().squeeze(1)


def _embedded(path: Path, vertices: Tensor, faces: Tensor) -> Landmarks:
    stored = load_object_array(path)
    try:
        on, weights = (
            torch.from_numpy(as_array(stored[f"full_lmk_{key}"]).astype(kind))
            for key, kind in (("faces_idx", np.int64), ("bary_coords", np.float64))
        )
        on, weights = on.reshape(-1), weights.reshape(-1, 3)
    except (LookupError, TypeError, ValueError, RuntimeError) as error:
        raise ReadError(
            f"{path} has no 'full_lmk_faces_idx' and 'full_lmk_bary_coords', expected the 70 "
            "landmarks that GaussianAvatars ships"
        ) from error
    count = IBUG_POINTS + len(EYES)
    on_mesh = len(on) > 0 and int(on.min()) >= 0 and int(on.max()) < len(faces)
    if len(on) != count or len(weights) != count or not on_mesh:
        raise ReadError(
            f"{path} has {len(on)} points on faces up to {int(on.max()) if len(on) else 0}, "
            f"expected {count} on the {len(faces)} faces of FLAME"
        )
    points = (vertices[faces[on]] * weights[:, :, None]).sum(1)
    return Landmarks(points, (*(f"ibug_{i}" for i in range(IBUG_POINTS)), *EYES))
