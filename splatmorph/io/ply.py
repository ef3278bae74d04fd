"""PLY splats: Inria's layout out, any order and number type in."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from splatmorph.errors import LocalFrameError, ReadError
from splatmorph.gaussians import MAX_SH_DEGREE, Gaussians
from splatmorph.io.axes import vertical_axis, vertical_comments
from splatmorph.io.checks import check_count, check_stored
from splatmorph.io.compressed_ply import is_compressed, unpack
from splatmorph.io.dialects import (
    COLOUR,
    DEFORMATION,
    SCALES,
    dialects_of,
    finite_logits,
    translated,
)
from splatmorph.io.elements import Columns, Rows, read_elements, write_elements
from splatmorph.io.layout import read_layout
from splatmorph.io.offsets import with_offset, without_offset

MEANS = ("x", "y", "z")
NORMALS = ("nx", "ny", "nz")
QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
REQUIRED = (*MEANS, *COLOUR, "opacity", *SCALES, *QUATS)
BINDING = "binding_0"

# torch has little arithmetic for wide unsigned integers; these hold every value of theirs.
EXTRA_TYPES: dict[Any, np.dtype[Any]] = {
    np.dtype("u2"): np.dtype("i4"),
    np.dtype("u4"): np.dtype("f8"),
}


PART = 1 << 15
"""Splats that are put into a file's order at a time."""

BLOCK = 2048
"""Splats whose properties, which lie together in a file, fit a core's cache."""


def read_ply(path: str | Path) -> Gaussians:
    """Read a splat in world space from a PLY file: ascii or binary, properties in any order.

    A compressed PLY is recognised by what it holds, whatever its name, and so are the dialects of
    ``dialects.py``.

    Raises:
        LocalFrameError: positions are in the frames of mesh triangles (``binding_0``).
        ReadError: see :func:`splatmorph.io.read`.
    """
    elements, up = read_elements(path), vertical_axis(read_layout(Path(path)).comments)
    if is_compressed(elements):
        return replace(unpack(elements, path), up=up)
    columns = _plain_splat(elements, path)
    if BINDING in columns:
        raise LocalFrameError(
            f"{path} is a GaussianAvatars file (property {BINDING}): its splats lie in the frames "
            "of mesh triangles; give the avatar's directory, with flame_param.npz or "
            "mesh_verts.npy beside the file, or bake it first"
        )
    return replace(gaussians_from_properties(columns, path), up=up)


def ply_layout(path: str | Path) -> str:
    """In words, which of the layouts that we know a PLY file has.

    Raises:
        ReadError: the file is missing, empty, truncated or no PLY.
    """
    elements = {one.name: dict(one.fields) for one in read_layout(Path(path)).elements}
    properties = elements.get("vertex", {})
    if is_compressed(elements):
        return "compressed PLY of SuperSplat"
    spoken = dialects_of(properties)
    if (Path(path).parent / DEFORMATION).is_file():
        return f"PLY of a splat of many moments, read where {DEFORMATION} beside it moves nothing"
    names = [f"{dialect.name} ({dialect.writers})" for dialect in spoken]
    return "PLY with " + " and ".join(names) if names else "PLY as Inria lays it out"


def read_properties(path: str | Path) -> Columns:
    """The properties of the splats in a PLY file by Inria's names, (n,) each, native byte order.

    Raises:
        ReadError: the file is missing, empty, truncated, no PLY, or holds no splats.
    """
    return _plain_splat(read_elements(path), path)


def gaussians_from_properties(columns: Columns, path: str | Path) -> Gaussians:
    """The splat that PLY properties describe; ``path`` is for the messages.

    Raises:
        ReadError: the SH count fits no degree, or values that no renderer can show.
    """
    rest = _rest_names(columns, path)
    per_channel = len(rest) // 3
    n = len(columns["x"])
    # The file has channel after channel; a splat's colours have the channels last.
    by_coefficient = [rest[i::per_channel] for i in range(per_channel)]
    sh = _stack(columns, [*COLOUR, *chain.from_iterable(by_coefficient)])
    known = {*REQUIRED, *rest, *NORMALS}
    extras = {name: _extra(value) for name, value in columns.items() if name not in known}
    if any(np.any(columns[name]) for name in NORMALS if name in columns):
        extras |= {name: _extra(columns[name]) for name in NORMALS if name in columns}
    log_scales = _stack(columns, SCALES)
    means, offset = without_offset(np.stack([columns[name] for name in MEANS], 1), log_scales)
    gaussians = Gaussians(
        means=torch.from_numpy(means),
        quats=torch.from_numpy(_stack(columns, QUATS)),
        log_scales=torch.from_numpy(log_scales),
        opacity_logits=torch.from_numpy(finite_logits(columns["opacity"])),
        sh=torch.from_numpy(sh.reshape(n, per_channel + 1, 3)),
        extras=extras,
        offset=offset,
    )
    check_stored(gaussians, path)
    return gaussians


def write_ply(path: str | Path, gaussians: Gaussians, comments: Sequence[str] = ()) -> None:
    """Write Inria's layout, float32 little endian: x y z, normals, SH, opacity, scales, quats.

    Normals are zero unless the splat was read with others. Extras follow in their own types, and
    centers too far from the origin for float32 are doubles.

    Raises:
        WriteError: see :func:`splatmorph.io.write`.
    """
    header = [*vertical_comments(gaussians), *comments]
    # All of them, since their types depend on all.
    means = with_offset(gaussians)
    slices = [slice(begin, begin + PART) for begin in range(0, max(1, len(gaussians)), PART)]
    parts = (_records(gaussians.select(part), means[part]) for part in slices)
    dtype = _records(gaussians.select(slice(1)), means[:1]).dtype
    write_elements(path, {"vertex": Rows(dtype, len(gaussians), parts)}, header)


def ply_size(gaussians: Gaussians) -> int:
    """Bytes of the splats in a PLY file, its header apart."""
    extras = sum(value.element_size() for value in gaussians.extras.values())
    return len(gaussians) * (
        4 * (len(REQUIRED) + len(NORMALS) + 3 * gaussians.sh.shape[1] - 3) + extras
    )


def _records(gaussians: Gaussians, means: NDArray[Any]) -> NDArray[np.void]:
    per_channel = gaussians.sh.shape[1] - 1
    rest = [f"f_rest_{i}" for i in range(3 * per_channel)]
    names = [*MEANS, *NORMALS, *COLOUR, *rest, "opacity", *SCALES, *QUATS]
    extras = {name: value.cpu().numpy() for name, value in gaussians.extras.items()}
    own = {name: means[:, i] for i, name in enumerate(MEANS) if means.dtype != np.float32}
    own |= {name: value for name, value in extras.items() if name not in NORMALS}
    n = len(gaussians)
    table = np.zeros((n, len(names)), "<f4")
    sh = gaussians.sh.cpu().numpy()
    table[:, 0:3] = means
    for i, name in enumerate(NORMALS):
        if name in extras:
            table[:, 3 + i] = extras[name]
    table[:, 6:9] = sh[:, 0]
    table[:, 9 : 9 + len(rest)] = sh[:, 1:].transpose(0, 2, 1).reshape(n, -1)
    table[:, -8] = gaussians.opacity_logits.cpu()
    table[:, -7:-4] = gaussians.log_scales.cpu()
    table[:, -4:] = gaussians.quats.cpu()
    if not own:
        return table.view([(name, table.dtype) for name in names])[:, 0]
    columns = {name: table[:, i] for i, name in enumerate(names)} | own
    fields = [(name, column.dtype.newbyteorder("<")) for name, column in columns.items()]
    records = np.empty(n, fields)
    for name, column in columns.items():
        records[name] = column
    return records


def _stack(columns: Columns, names: Sequence[str]) -> NDArray[np.float32]:
    out = np.empty((len(columns[names[0]]), len(names)), np.float32)
    for begin in range(0, len(out), BLOCK):
        rows = slice(begin, begin + BLOCK)
        for i, name in enumerate(names):
            out[rows, i] = columns[name][rows]
    return out


def _extra(value: NDArray[np.generic]) -> torch.Tensor:
    return torch.from_numpy(value.astype(EXTRA_TYPES.get(value.dtype, value.dtype)))


def _rest_names(columns: Columns, path: str | Path) -> list[str]:
    found = {name for name in columns if re.fullmatch(r"f_rest_\d+", name)}
    count = len(found)
    rest = [f"f_rest_{i}" for i in range(count)]
    allowed = [3 * ((degree + 1) ** 2 - 1) for degree in range(MAX_SH_DEGREE + 1)]
    if count not in allowed or found != set(rest):
        raise ReadError(
            f"{path} has {count} f_rest properties, which fit no SH degree: expected "
            f"{', '.join(map(str, allowed))}, numbered from 0; export it again with one SH degree"
        )
    return rest


def _plain_splat(elements: Mapping[str, Columns], path: str | Path) -> Columns:
    if "vertex" not in elements:
        names = ", ".join(elements) or "nothing"
        raise ReadError(f"{path} has no vertices (it holds {names}), expected a splat PLY")
    columns = translated(elements["vertex"], path)
    missing = [name for name in REQUIRED if name not in columns]
    if not missing:
        check_count(len(columns["x"]), path)
        return columns
    if {"face", "tristrips"} & elements.keys():
        kind = "a mesh; train or convert it to 3D Gaussians first"
    elif len(missing) < len(REQUIRED) - len(MEANS) - 1:
        kind = f"an incomplete splat, without {', '.join(missing)}; export it again in full"
    elif "red" in columns or "r" in columns:
        kind = "a coloured point cloud; train or convert it to 3D Gaussians first"
    else:
        kind = f"no splat, for it lacks {', '.join(missing)}"
    raise ReadError(f"{path} is {kind}")
