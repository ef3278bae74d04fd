"""What the lossy formats share: opacities in bytes, quaternions less one component, whole files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from splatmorph.errors import ReadError, WriteError
from splatmorph.gaussians import Gaussians
from splatmorph.io.checks import check_count, check_drawable
from splatmorph.io.reading import reading, require_file

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]

FAINTEST = 1e-6
"""Opacities of 0 and 1 have no finite logit; they are read as this far from it."""


def read_bytes(path: Path) -> bytes:
    """A whole file.

    Raises:
        ReadError: it is missing or empty.
    """
    require_file(path)
    with reading(path, "file"):
        data = path.read_bytes()
    if not data:
        raise ReadError(f"{path} is empty, expected a splat: export or download it again")
    return data


def stored_arrays(gaussians: Gaussians, path: str | Path) -> tuple[Array, Array, Array, Array]:
    """means (n, 3), unit quats (n, 4), log scales (n, 3) and sh (n, k, 3), to be rounded.

    Raises:
        WriteError: no splats, values that aren't finite, or a zero quaternion.
    """
    if len(gaussians) == 0:
        raise WriteError(f"{path} can't hold a splat of nothing: write a .ply")
    check_drawable(gaussians, f"the splat for {path}", WriteError)
    fields = (gaussians.absolute_means, gaussians.quats, gaussians.log_scales, gaussians.sh)
    means, quats, log_scales, sh = (field.detach().cpu().double().numpy() for field in fields)
    return means, quats / np.linalg.norm(quats, axis=1, keepdims=True), log_scales, sh


def unpacked(
    path: str | Path,
    *,
    means: NDArray[Any],
    quats: NDArray[Any],
    log_scales: NDArray[Any],
    opacities: NDArray[Any],
    sh: NDArray[Any],
) -> Gaussians:
    """The splat of what was decoded, opacities in [0, 1]; ``path`` is for the messages.

    Raises:
        ReadError: no splats, or values that no renderer can show.
    """
    check_count(len(means), path)
    alphas = np.clip(opacities.astype(np.float64), FAINTEST, 1 - FAINTEST)
    logits = np.log(alphas / (1 - alphas))
    gaussians = Gaussians(
        means=_tensor(means),
        quats=_tensor(quats),
        log_scales=_tensor(log_scales),
        opacity_logits=_tensor(logits),
        sh=_tensor(sh),
    )
    check_drawable(gaussians, path)
    return gaussians


def opacity_bytes(gaussians: Gaussians) -> Bytes:
    """(n,) opacities as 0 to 255."""
    return as_bytes(gaussians.opacity_logits.detach().cpu().double().sigmoid().numpy() * 255)


def as_bytes(values: Array) -> Bytes:
    """Values rounded and clipped to 0 … 255."""
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def drop_largest(quats: Array) -> tuple[NDArray[np.int64], Array]:
    """Unit quaternions without the component that the others give.

    Returns:
        index: (n,) of the largest component, whose sign is made positive.
        rest: (n, 3) the others in their order, each within ±1/√2.
    """
    index = np.abs(quats).argmax(axis=1)
    dropped = np.arange(4) == index[:, None]
    positive = np.where(quats[dropped][:, None] < 0, -quats, quats)
    return index, positive[~dropped].reshape(-1, 3)


def restore_largest(index: NDArray[Any], rest: Array) -> Array:
    """(n, 4) unit quaternions, the inverse of :func:`drop_largest`."""
    dropped = np.arange(4) == index[:, None]
    quats = np.empty(dropped.shape)
    quats[~dropped] = rest.ravel()
    quats[dropped] = np.sqrt(np.maximum(0, 1 - (rest**2).sum(axis=1)))
    return quats


def _tensor(values: NDArray[Any]) -> torch.Tensor:
    # Copied where it lies in the bytes of a file, which can't be written to.
    kept = np.require(values, np.float32, ["C", "W"])
    return torch.from_numpy(kept)
