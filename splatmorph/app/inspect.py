"""``splatmorph inspect``: Say what a splat or an avatar is: counts, bounds, frame, bad values."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.options import Json
from splatmorph.errors import MissingExtraError, ReadError, SplatmorphError

if TYPE_CHECKING:
    from splatmorph.gaussians import Gaussians
    from splatmorph.registration.face_network import FaceNetwork
    from splatmorph.runs import Input


def inspect(
    files: Annotated[tuple[Path, ...], Parameter(help="Splats or avatar directories.")],
    /,
    *,
    json: Json = False,
) -> None:
    """Say what a splat or an avatar is: counts, bounds, frame, landmarks, bad values."""
    described, first_error = [], None
    for file in files:
        try:
            described.append(describe(file))
        except SplatmorphError as error:
            first_error = first_error or error
            described.append({"file": str(file), "error": console.spoken(error)})
    if json:
        console.emit_json({"files": described})
    else:
        for one in described:
            _print(one)
    if first_error is not None:
        raise first_error


def describe(file: Path) -> dict[str, Any]:
    """What ``inspect`` says of one file, in JSON's types."""
    import torch

    from splatmorph import io
    from splatmorph.avatars import is_avatar
    from splatmorph.gaussians import FAINTEST_DRAWN
    from splatmorph.runs.inputs import bounding_box, load_input

    rig: dict[str, Any] = {}
    if is_avatar(file):
        rig = _rig(file)
        if rig["missing"]:
            return {"file": str(file), **rig}
    loaded = load_input(file)
    gaussians = loaded.gaussians
    offset = torch.tensor(gaussians.offset).double()
    low, high = ((corner + offset).tolist() for corner in bounding_box(gaussians))
    largest = gaussians.scales.amax(dim=1)
    norms = gaussians.quats.norm(dim=1)
    return {
        "file": str(file),
        "kind": "splat in world space",
        "layout": "GaussianAvatars" if rig else io.layout(file),
        **rig,
        "splats": len(gaussians),
        "sh_degree": gaussians.sh_degree,
        "bounds_98_percent": [low, high],
        "up": _up(gaussians),
        **_far(gaussians),
        "median_largest_scale": float(largest.median()),
        "median_opacity": float(gaussians.opacities.median()),
        "invisible": int((gaussians.opacities < FAINTEST_DRAWN).sum()),
        "unnormalised_quats": int(((norms - 1).abs() > 1e-3).sum()),
        "extras": sorted(gaussians.extras),
        "landmarks": _landmarks(loaded),
    }


def _up(gaussians: Gaussians) -> str:
    from splatmorph.runs.upright import standing_way

    axis, why = standing_way(gaussians, _faces() if gaussians.up is None else None)
    hint = f": --up {axis} is likely right" if axis != "y" and gaussians.up is None else ""
    return f"{axis} ({why}{hint})"


def _faces() -> FaceNetwork | None:
    """What sees faces, where it is at hand."""
    from splatmorph.registration.face_network import find_model, load_network

    try:
        return load_network(find_model())
    except (ReadError, MissingExtraError):
        return None


def _far(gaussians: Gaussians) -> dict[str, Any]:
    """What is to be said of centers far from the origin."""
    from splatmorph.io.offsets import lost_detail

    said: dict[str, Any] = {"offset": list(gaussians.offset)} if any(gaussians.offset) else {}
    if (spacing := lost_detail(gaussians)) is not None:
        said["centers_rounded_to"] = spacing
    return said


def _rig(file: Path) -> dict[str, Any]:
    from splatmorph.avatars import summarize

    found = summarize(file)
    return {
        "kind": "avatar of GaussianAvatars, in the frames of mesh triangles; posed for the rest",
        "splats": found.splats,
        "sh_degree": found.sh_degree,
        "faces_with_splats": found.faces_bound,
        "teeth": found.teeth,
        "track_frames": found.frames,
        "mesh": found.mesh_file and str(found.mesh_file),
        "FLAME": str(found.flame_file) if found.flame_file else "not found",
        "missing": found.hint and console.spoken(found.hint),
    }


def _landmarks(loaded: Input) -> dict[str, Any] | None:
    if loaded.landmarks is None:
        return None
    names = loaded.landmarks.names
    return {"count": len(loaded.landmarks), "named": names is not None}


def _print(one: dict[str, Any]) -> None:
    console.say(one["file"])
    for key, value in one.items():
        if key != "file":
            console.say(f"  {key.replace('_', ' '):22}{_readable(key, value)}")


def _readable(key: str, value: Any) -> str:
    if key == "bounds_98_percent":
        low, high = ("(" + ", ".join(f"{x:.4g}" for x in corner) + ")" for corner in value)
        return f"{low} to {high}"
    if key == "landmarks":
        kind = "named" if value and value["named"] else "by order"
        return f"{value['count']}, {kind}" if value else "none beside it"
    if key == "extras":
        return ", ".join(value) or "none"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
