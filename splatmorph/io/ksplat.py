"""``.ksplat`` of GaussianSplats3D (mkkellogg), versions 0.0 and 0.1: read, not written.

A header of 4096 bytes, one of 1024 for each section, then the sections: lengths of the buckets that
aren't full, the buckets' centers, the splats. Compressed positions are steps from the center of
their bucket: x = c + (q - range) · (block / 2) / range.
https://github.com/mkkellogg/GaussianSplats3D/blob/main/src/loaders/SplatBuffer.js
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splatmorph.errors import ReadError
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import SH0
from splatmorph.io.packed import read_bytes, unpacked

HEADER, SECTION, CENTER = 4096, 1024, 12
STEPS = 32767
"""Half the steps of a compressed position, where a section names none."""
HALF_RANGE = 1.5
"""Harmonics in bytes lie within this of 0, where the header names no range."""
NUMBERS = {0: ("<f4", "<f4", "<f4"), 1: ("<u2", "<f2", "<f2"), 2: ("<u2", "<f2", "u1")}
"""By level of compression: the types of positions, of scales and rotations, of harmonics."""
HIGHEST_DEGREE = 2
FLOAT = np.finfo(np.float32)


@dataclass(frozen=True)
class _Header:
    sections: int
    level: int
    darkest: float
    brightest: float
    """What the bytes 0 and 255 of a harmonic stand for."""


@dataclass(frozen=True)
class _Section:
    splats: int
    """Those that are there, of ``room`` that there is room for."""
    room: int
    bucket: int
    """Splats in a full bucket."""
    buckets: int
    block: float
    """Side of a bucket."""
    record: int
    """Bytes of a bucket's center, three floats."""
    steps: int
    full: int
    partial: int
    degree: int


def read_ksplat(path: str | Path) -> Gaussians:
    """Read a ``.ksplat`` file, the splats in its order.

    Raises:
        ReadError: see :func:`splatmorph.io.read`.
    """
    path = Path(path)
    data = read_bytes(path)
    header = _header(data, path)
    at = HEADER + header.sections * SECTION
    parts: list[NDArray[np.void]] = []
    places: list[NDArray[np.float64]] = []
    for i in range(header.sections):
        section = _section(data, HEADER + i * SECTION)
        record = _record(header.level, section.degree)
        start = at + 4 * section.partial + section.record * section.buckets
        end = start + record.itemsize * section.room
        if end > len(data):
            raise ReadError(
                f"{path} ends after {len(data)} bytes, its section {i + 1} needs {end}: "
                "it is truncated; download or export it again"
            )
        found = np.frombuffer(data, record, section.splats, start)
        places.append(_positions(data[at:start], section, found["means"], header.level))
        parts.append(found)
        at = end
    return _splat(path, header, parts, places)


def ksplat_layout(path: str | Path) -> str:
    """In words, how a ``.ksplat`` file is packed.

    Raises:
        ReadError: see :func:`splatmorph.io.read`.
    """
    header = _header(read_bytes(Path(path)), Path(path))
    return f"ksplat of GaussianSplats3D, compression level {header.level}"


def _header(data: bytes, path: Path) -> _Header:
    if len(data) < HEADER or data[0] != 0 or data[1] > 1:
        raise ReadError(
            f"{path} is no .ksplat of version 0.0 or 0.1: it is truncated or another format; "
            "download or export it again"
        )
    (room,) = struct.unpack_from("<I", data, 4)
    (level,) = struct.unpack_from("<H", data, 20)
    darkest, brightest = struct.unpack_from("<2f", data, 36)
    if level not in NUMBERS or HEADER + room * SECTION > len(data):
        raise ReadError(
            f"{path} has compression level {level} and {room} sections in {len(data)} bytes, "
            f"expected a level of 0 to {max(NUMBERS)} and room for the sections: it is damaged"
        )
    return _Header(room, level, darkest or -HALF_RANGE, brightest or HALF_RANGE)


def _section(data: bytes, at: int) -> _Section:
    splats, room, bucket, buckets = struct.unpack_from("<4I", data, at)
    (block, record, steps) = struct.unpack_from("<fH2xI", data, at + 16)
    full, partial = struct.unpack_from("<2I", data, at + 32)
    (degree,) = struct.unpack_from("<H", data, at + 40)
    if degree > HIGHEST_DEGREE or splats > room or (buckets and record != CENTER):
        raise ValueError(
            f"a section has harmonics of degree {degree}, {splats} of {room} splats and centers of "
            f"{record} bytes"
        )
    return _Section(
        splats, room, bucket, buckets, block, record, steps or STEPS, full, partial, degree
    )


def _record(level: int, degree: int) -> np.dtype[np.void]:
    place, number, harmonic = NUMBERS[level]
    return np.dtype(
        [
            ("means", place, 3),
            ("scales", number, 3),
            ("quats", number, 4),
            ("rgba", "u1", 4),
            ("sh", harmonic, (3 * ((degree + 1) ** 2 - 1),)),
        ]
    )


def _positions(
    head: bytes, section: _Section, stored: NDArray[np.generic], level: int
) -> NDArray[np.float64]:
    """(n, 3) positions; ``head`` holds the lengths of partial buckets and all centers."""
    if level == 0:
        return stored.astype(np.float64)
    lengths = np.frombuffer(head, "<u4", section.partial).astype(np.int64)
    centers = np.frombuffer(head, "<f4", offset=4 * section.partial).reshape(-1, 3)
    counts = np.concatenate([np.full(min(section.full, section.buckets), section.bucket), lengths])
    ends = np.cumsum(counts)
    owner = np.searchsorted(ends, np.arange(len(stored)), side="right")
    if len(stored) and owner[-1] >= len(centers):
        raise ValueError("its buckets hold fewer splats than it has")
    steps = stored.astype(np.float64) - section.steps
    places: NDArray[np.float64] = centers[owner] + steps * (section.block / 2 / section.steps)
    return places


def _splat(
    path: Path,
    header: _Header,
    parts: Sequence[NDArray[np.void]],
    places: Sequence[NDArray[np.float64]],
) -> Gaussians:
    bands = [_harmonics(part["sh"], header) for part in parts]
    most = max((one.shape[1] for one in bands), default=0)
    rgba = np.concatenate([part["rgba"] for part in parts] or [np.zeros((0, 4))])
    rest = [np.pad(one, ((0, 0), (0, most - one.shape[1]), (0, 0))) for one in bands]
    base = ((rgba[:, :3] / 255 - 0.5) / SH0)[:, None]
    scales = np.concatenate([part["scales"] for part in parts] or [np.zeros((0, 3))])
    return unpacked(
        path,
        means=np.concatenate(places or [np.zeros((0, 3))]),
        quats=np.concatenate([part["quats"] for part in parts] or [np.zeros((0, 4))]),
        # Halfs have no room for the smallest scales.
        log_scales=np.log(np.maximum(scales.astype(np.float64), FLOAT.tiny)),
        opacities=rgba[:, 3] / 255,
        sh=np.concatenate([base, np.concatenate(rest)], axis=1) if rest else base,
    )


def _harmonics(stored: NDArray[np.generic], header: _Header) -> NDArray[np.float64]:
    """(n, k, 3) harmonics above degree 0, which lie by degree, then by channel."""
    values = stored.astype(np.float64)
    if header.level == 2:
        values = header.darkest + values / 255 * (header.brightest - header.darkest)
    bands, at = [np.zeros((len(values), 0, 3))], 0
    for width in (3, 5):
        if at < values.shape[1]:
            band = values[:, at : at + 3 * width]
            bands.append(band.reshape(-1, 3, width).transpose(0, 2, 1))
            at += 3 * width
    return np.concatenate(bands, axis=1)
