"""glTF and GLB with KHR_gaussian_splatting: splats as the points of a mesh, y up.

Scales and opacities are stored activated, quaternions as xyzw, one accessor an attribute. SPZ
streams inside are read. https://github.com/KhronosGroup/glTF/tree/main/extensions/2.0/Khronos
"""

from __future__ import annotations

import base64
import json
import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from splatmorph._version import __version__
from splatmorph.errors import ReadError
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import SH0
from splatmorph.geometry.quaternions import from_matrices, normalized, to_matrices
from splatmorph.geometry.similarity import Similarity
from splatmorph.io.atomic import atomic_write
from splatmorph.io.axes import upright
from splatmorph.io.gltf_buffers import BINARY_CHUNK, GLB, JSON_CHUNK, Document, read_document
from splatmorph.io.offsets import about, without_offset
from splatmorph.io.packed import FAINTEST, as_bytes, stored_arrays, unpacked
from splatmorph.io.spz import unpack_spz

Array = NDArray[np.float64]

SPLATS = "KHR_gaussian_splatting"
SPZ = ("KHR_gaussian_splatting_compression_spz_2", "KHR_gaussian_splatting_compression_spz")
OLD_SPZ = "KHR_spz_gaussian_splats_compression"
"""A draft's name for it, beside the other extension and not inside."""
GAMMA, LINEAR = "srgb_rec709_display", "lin_rec709_display"
HIGHEST_DEGREE = 3
FLOAT, BYTE, POINTS, ARRAY_BUFFER = 5126, 5121, 0, 34962

LINEAR_KNEE = 0.0031308


def read_gltf(path: str | Path) -> Gaussians:
    """Read every splat of a glTF's scene, in world space.

    Raises:
        ReadError: see :func:`splatmorph.io.read`; or a scene without splats, or of a kernel that
            we don't draw.
    """
    path = Path(path)
    document = read_document(path)
    parts = [
        placed(_splats_of(document, primitive), matrix, path)
        for primitive, matrix in _primitives(document)
    ]
    if not parts:
        raise ReadError(
            f"{path} holds no splats ({SPLATS}), only meshes: train or convert it to 3D Gaussians"
        )
    whole = parts[0]
    for part in parts[1:]:
        whole = Gaussians.union(whole, about(part, whole.offset))
    return replace(whole, up="y")


def gltf_layout(path: str | Path) -> str:
    """In words, the extensions by which a glTF file holds splats.

    Raises:
        ReadError: see :func:`splatmorph.io.read`.
    """
    used = read_document(Path(path)).content.get("extensionsUsed", [])
    ours = [name for name in used if name in (SPLATS, OLD_SPZ, *SPZ)]
    return f"glTF with {' and '.join(ours) or 'no splats'}"


def write_gltf(path: str | Path, gaussians: Gaussians, comments: Sequence[str] = ()) -> None:
    """Write ``.glb``, or ``.gltf`` with its data inside, in the order of ``gaussians``.

    Harmonics go to degree 3; an offset is the node's translation. The splats should have y up,
    as :func:`splatmorph.io.write` sees to.

    Raises:
        WriteError: see :func:`splatmorph.io.write`.
    """
    path = Path(path)
    gaussians = gaussians.with_sh_degree(min(gaussians.sh_degree, HIGHEST_DEGREE))
    attributes = _attributes(gaussians, path)
    content = _content(attributes, gaussians, comments)
    data = b"".join(values.tobytes() for values in attributes.values())
    with atomic_write(path) as partial, partial.open("wb") as stream:
        if path.suffix.lower() == ".gltf":
            inside = base64.b64encode(data).decode("ascii")
            content["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{inside}"
            stream.write(json.dumps(content).encode())
            return
        text = json.dumps(content).encode()
        text += b" " * (-len(text) % 4)
        stream.write(struct.pack("<III", GLB, 2, 28 + len(text) + len(data)))
        stream.write(struct.pack("<II", len(text), JSON_CHUNK) + text)
        stream.write(struct.pack("<II", len(data), BINARY_CHUNK))
        stream.write(data)


# Reading ------------------------------------------------------------------------------------


def _primitives(document: Document) -> Iterator[tuple[Mapping[str, Any], Array]]:
    """Splat primitives of the scene and the matrices mesh → world of their nodes."""
    content = document.content
    nodes = content.get("nodes", [])
    scenes = content.get("scenes", [])
    roots = scenes[content.get("scene", 0)].get("nodes", []) if scenes else range(len(nodes))
    waiting = [(node, np.eye(4)) for node in roots]
    visited = 0
    while waiting:
        index, above = waiting.pop(0)
        visited += 1
        if visited > len(nodes):
            raise ValueError("its nodes go round in a circle")
        node = nodes[index]
        matrix = above @ _local(node)
        waiting += [(child, matrix) for child in node.get("children", [])]
        if "mesh" in node:
            for primitive in content["meshes"][node["mesh"]]["primitives"]:
                if {SPLATS, OLD_SPZ} & primitive.get("extensions", {}).keys():
                    yield primitive, matrix


def _local(node: Mapping[str, Any]) -> Array:
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    turn = _rotations(np.array([[w, x, y, z]], float))[0]
    matrix[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)), float)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _splats_of(document: Document, primitive: Mapping[str, Any]) -> Gaussians:
    extensions = primitive["extensions"]
    ours = extensions.get(SPLATS, {})
    if (kernel := ours.get("kernel", "ellipse")) != "ellipse":
        raise ReadError(f"{document.path} has splats of the kernel {kernel!r}, expected 'ellipse'")
    inside = {**extensions, **ours.get("extensions", {})}
    for name in (*SPZ, OLD_SPZ):
        if name in inside:
            stream = bytes(document.view(inside[name]["bufferView"]))
            return upright(unpack_spz(stream, document.path), "y")
    gaussians = _of_attributes(document, primitive["attributes"])
    space = ours.get("colorSpace", GAMMA)
    if space not in (GAMMA, LINEAR):
        raise ReadError(
            f"{document.path} has colours in {space!r}, expected {GAMMA!r} or {LINEAR!r}"
        )
    return replace(gaussians, sh=_gamma(gaussians.sh)) if space == LINEAR else gaussians


def _of_attributes(document: Document, attributes: Mapping[str, int]) -> Gaussians:
    def values(name: str) -> NDArray[Any]:
        key = name if name == "POSITION" else f"{SPLATS}:{name}"
        if key not in attributes:
            raise ReadError(f"{document.path} has splats without {key}: export it again")
        return document.accessor(attributes[key])

    means = values("POSITION")
    sh = [values("SH_DEGREE_0_COEF_0")]
    for degree in range(1, HIGHEST_DEGREE + 1):
        if f"{SPLATS}:SH_DEGREE_{degree}_COEF_0" not in attributes:
            break
        sh += [values(f"SH_DEGREE_{degree}_COEF_{i}") for i in range(2 * degree + 1)]
    with np.errstate(divide="ignore", invalid="ignore"):
        log_scales = np.log(values("SCALE").astype(np.float64))
    # A scale of 0 has no log; nothing is thinner than this.
    log_scales = np.where(np.isneginf(log_scales), np.log(np.finfo(np.float32).tiny), log_scales)
    parts = {
        "means": means,
        "quats": np.roll(values("ROTATION"), 1, axis=1),
        "log_scales": log_scales,
        "opacities": values("OPACITY").reshape(-1),
        "sh": np.stack(sh, axis=1),
    }
    if any(len(part) != len(means) for part in parts.values()):
        raise ValueError("its attributes differ in their number of splats")
    return unpacked(document.path, **parts)


def _gamma(sh: torch.Tensor) -> torch.Tensor:
    """Linear colours as display-referred ones: the mean colour exactly, its change to first order.

    c' = f(c), and with f' = df/dc higher harmonics times f'.
    """
    colour = (0.5 + SH0 * sh[:, :1].double()).clamp(min=0)
    curve = colour.clamp(min=LINEAR_KNEE)
    shown = torch.where(colour > LINEAR_KNEE, 1.055 * curve ** (1 / 2.4) - 0.055, 12.92 * colour)
    slope = torch.where(colour > LINEAR_KNEE, 1.055 / 2.4 * curve ** (1 / 2.4 - 1), 12.92)
    return torch.cat([(shown - 0.5) / SH0, sh[:, 1:] * slope], dim=1).to(sh.dtype)


def placed(gaussians: Gaussians, matrix: Array, path: Path) -> Gaussians:
    """The splats of a mesh in world space, x ↦ M x + t.

    Σ' = M Σ Mᵀ; its axes come from the singular values of M R S, which leaves splats that M only
    turns and scales what they are. Colours turn with the rotation in M.
    """
    linear, shift = matrix[:3, :3], matrix[:3, 3]
    if np.array_equal(matrix, np.eye(4)):
        return gaussians
    if not np.isfinite(matrix).all() or not np.linalg.det(linear) > 0:
        raise ReadError(f"{path} mirrors or flattens its splats by a node, which has no meaning")
    left, _, right = np.linalg.svd(linear)
    scale = float(np.cbrt(np.linalg.det(linear)))
    turn = Similarity(torch.from_numpy(left @ right), scale, torch.zeros(3))
    exact = gaussians.means.double().numpy() @ linear.T + shift
    moved = gaussians.moved(turn)
    if not np.allclose(linear, scale * (left @ right), atol=1e-5 * scale):
        moved = _stretched(gaussians, moved, linear)
    means, offset = without_offset(exact, moved.log_scales.numpy())
    return replace(moved, means=torch.from_numpy(means), offset=offset)


def _stretched(gaussians: Gaussians, moved: Gaussians, linear: Array) -> Gaussians:
    turns = to_matrices(normalized(gaussians.quats.double()))
    halves = torch.from_numpy(linear) @ turns * gaussians.scales.double()[:, None]
    axes, lengths, _ = torch.linalg.svd(halves)
    axes[:, :, 2] *= torch.linalg.det(axes)[:, None]
    tiny = torch.finfo(torch.float32).tiny
    return replace(
        moved,
        quats=from_matrices(axes).float(),
        log_scales=lengths.clamp(min=tiny).log().float(),
    )


def _rotations(quats: Array) -> Array:
    return np.asarray(to_matrices(normalized(torch.from_numpy(quats))).numpy())


# Writing ------------------------------------------------------------------------------------


def _attributes(gaussians: Gaussians, path: Path) -> dict[str, NDArray[Any]]:
    """The accessors' arrays by their semantics, each a whole number of words long."""
    _, quats, log_scales, sh = stored_arrays(gaussians, path)
    alphas = gaussians.opacity_logits.detach().cpu().double().sigmoid().numpy()
    colours = np.clip(0.5 + SH0 * sh[:, 0], 0, 1)
    linear = np.where(colours > 0.04045, ((colours + 0.055) / 1.055) ** 2.4, colours / 12.92)
    values: dict[str, NDArray[Any]] = {
        "POSITION": gaussians.means.detach().cpu().numpy(),
        # What a viewer shows that knows points alone.
        "COLOR_0": as_bytes(255 * np.concatenate([linear, alphas[:, None]], axis=1)),
        "ROTATION": np.roll(quats, -1, axis=1),
        "SCALE": np.exp(log_scales).clip(np.finfo(np.float32).tiny, np.finfo(np.float32).max),
        "OPACITY": alphas.clip(FAINTEST, 1 - FAINTEST),
    }
    for degree in range(math.isqrt(sh.shape[1])):
        for i in range(2 * degree + 1):
            values[f"SH_DEGREE_{degree}_COEF_{i}"] = sh[:, degree**2 + i]
    return {
        name if name in ("POSITION", "COLOR_0") else f"{SPLATS}:{name}": np.ascontiguousarray(
            array, np.uint8 if name == "COLOR_0" else "<f4"
        )
        for name, array in values.items()
    }


def _content(
    attributes: Mapping[str, NDArray[Any]], gaussians: Gaussians, comments: Sequence[str]
) -> dict[str, Any]:
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    begin = 0
    for name, array in attributes.items():
        views.append(
            {"buffer": 0, "byteOffset": begin, "byteLength": array.nbytes, "target": ARRAY_BUFFER}
        )
        begin += array.nbytes
        accessors.append(
            {
                "bufferView": len(accessors),
                "componentType": BYTE if array.dtype == np.uint8 else FLOAT,
                "count": len(array),
                "type": f"VEC{array.shape[1]}" if array.ndim > 1 else "SCALAR",
            }
        )
        if array.dtype == np.uint8:
            accessors[-1]["normalized"] = True
        if name == "POSITION":
            accessors[-1] |= {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
    primitive = {
        "attributes": {name: i for i, name in enumerate(attributes)},
        "mode": POINTS,
        "extensions": {SPLATS: {"kernel": "ellipse", "colorSpace": GAMMA}},
    }
    node: dict[str, Any] = {"mesh": 0, "name": "splats"}
    if any(gaussians.offset):
        node["translation"] = list(gaussians.offset)
    asset: dict[str, Any] = {"version": "2.0", "generator": f"splatmorph {__version__}"}
    if comments:
        asset["extras"] = {"comments": list(comments)}
    return {
        "asset": asset,
        "extensionsUsed": [SPLATS],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            node | ({"translation": list(gaussians.offset)} if any(gaussians.offset) else {})
        ],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": begin}],
    }
