"""numpy's ``.npy`` and ``.npz``: numbers and text, no more than the file holds, no objects."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from splatmorph.errors import ReadError
from splatmorph.io.reading import reading, require_file

LARGEST = 512 << 20
"""Bytes of all arrays that are read from an archive, which can hold a thousand times its size."""
KINDS = "biufSU"
LAST_LETTER = 0x10FFFF
"""Of Unicode; numpy would make Python's text of any number."""
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def read_npy(path: Path, what: str = ".npy of numbers") -> NDArray[Any]:
    """The array of a ``.npy`` file.

    Raises:
        ReadError: it is missing, damaged, holds objects, or promises more than it has.
    """
    require_file(path)
    with reading(path, what), path.open("rb") as stream:
        return _array(stream, path.stat().st_size)


def read_npz(
    path: Path, wanted: Collection[str] | None = None, what: str = ".npz of arrays"
) -> dict[str, NDArray[Any]]:
    """The arrays of a ``.npz`` file by name; only the ``wanted``, where some are named.

    Raises:
        ReadError: it is missing, damaged, holds objects, or more than :data:`LARGEST` bytes.
    """
    require_file(path)
    with reading(path, what), zipfile.ZipFile(path) as archive:
        members = {
            entry.filename.removesuffix(".npy"): entry
            for entry in archive.infolist()
            if entry.filename.endswith(".npy")
        }
        if wanted is not None:
            members = {name: entry for name, entry in members.items() if name in wanted}
        size = sum(entry.file_size for entry in members.values())
        if size > LARGEST:
            raise ReadError(f"{path} holds {size >> 20} MB, expected at most {LARGEST >> 20}")
        return {name: _member(archive, entry) for name, entry in members.items()}


def _member(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    if entry.compress_type not in METHODS:
        raise ValueError(f"{entry.filename} is compressed in a way that numpy doesn't write")
    with archive.open(entry) as stream:
        array = _array(stream, entry.file_size)  # type: ignore[arg-type]
        # The checksum is compared at the end.
        stream.read(1)
    return array


def _array(stream: BinaryIO, size: int) -> NDArray[Any]:
    """The array in the next ``size`` bytes."""
    version = np.lib.format.read_magic(stream)
    header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if header is None:
        raise ValueError(f"version {version} of .npy, expected 1.0 or 2.0")
    shape, by_columns, dtype = header(stream)
    if dtype.kind not in KINDS or not dtype.itemsize:
        raise ValueError(f"it holds {dtype}, expected numbers or text")
    if not all(type(side) is int and side >= 0 for side in shape):
        raise ValueError(f"it has the shape {shape}")
    length = math.prod(shape) * dtype.itemsize
    if length > size:
        raise ValueError(f"it promises {length} bytes and has {size}")
    content = bytearray(length)
    if stream.readinto(content) != length:  # type: ignore[attr-defined]
        raise ValueError("it ends too early (truncated)")
    flat = np.frombuffer(content, dtype) if length else np.empty(0, dtype)
    if dtype.kind == "U" and flat.view(dtype.byteorder + "u4").max(initial=0) > LAST_LETTER:
        raise ValueError("it holds text of no letters")
    return flat.reshape(shape, order="F" if by_columns else "C")
