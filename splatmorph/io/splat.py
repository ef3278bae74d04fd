"""``.splat``: 32 bytes a splat and no header, as antimatter15/splat reads it.

float32 x y z, float32 standard deviations, 4 bytes RGB and opacity, 4 bytes quaternion wxyz as
128 + 128 q. There is no room for colour that depends on the view.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from splatmorph.errors import ReadError
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import SH0
from splatmorph.io.atomic import atomic_write
from splatmorph.io.packed import as_bytes, opacity_bytes, read_bytes, stored_arrays, unpacked

RECORD = np.dtype(
    [("means", "<f4", 3), ("scales", "<f4", 3), ("rgb", "u1", 3), ("alpha", "u1"), ("q", "u1", 4)]
)
FLOAT = np.finfo(np.float32)


def read_splat(path: str | Path) -> Gaussians:
    """Read a ``.splat`` file.

    Raises:
        ReadError: see :func:`splatmorph.io.read`.
    """
    data = read_bytes(Path(path))
    if len(data) % RECORD.itemsize:
        raise ReadError(
            f"{path} has {len(data)} bytes, no multiple of the {RECORD.itemsize} that a .splat "
            "takes a splat: it is truncated or another format; download or export it again"
        )
    records = np.frombuffer(data, RECORD)
    flat = (records["scales"] <= 0).any(axis=1)
    if flat.any():
        raise ReadError(
            f"{path} has {flat.sum()} splats with a scale of 0 or less, expected above 0: it is no "
            ".splat file or damaged; export it again"
        )
    return unpacked(
        path,
        means=records["means"],
        quats=(records["q"] - 128.0) / 128,
        log_scales=np.log(records["scales"]),
        opacities=records["alpha"] / 255,
        sh=((records["rgb"] / 255 - 0.5) / SH0)[:, None],
    )


def write_splat(path: str | Path, gaussians: Gaussians, comments: Sequence[str] = ()) -> None:
    """Write a ``.splat`` file, in the order of ``gaussians``; there is no room for ``comments``.

    Raises:
        WriteError: see :func:`splatmorph.io.write`.
    """
    means, quats, log_scales, sh = stored_arrays(gaussians, path)
    records = np.empty(len(gaussians), RECORD)
    records["means"] = means
    records["scales"] = np.exp(log_scales).clip(FLOAT.tiny, FLOAT.max)
    records["rgb"] = as_bytes((0.5 + SH0 * sh[:, 0]) * 255)
    records["alpha"] = opacity_bytes(gaussians)
    records["q"] = as_bytes(128 + 128 * quats)
    with atomic_write(path) as partial:
        partial.write_bytes(records.tobytes())
