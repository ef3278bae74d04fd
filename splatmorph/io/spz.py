"""``.spz`` of Niantic: every attribute of all splats in few bits, one attribute after the other.

A header, then positions in 24-bit fixed point, and in bytes opacities, colours, log scales,
quaternions and harmonics. Version 3, which is written here, and those before are one gzip stream;
version 4 is a stream of zstandard for each attribute. https://github.com/nianticlabs/spz

Axes point right, up and back, unless an extension says otherwise.
"""

from __future__ import annotations

import contextlib
import gzip
import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

import numpy as np

from splatmorph.errors import ReadError, WriteError
from splatmorph.gaussians import MAX_SH_DEGREE, Gaussians
from splatmorph.io.atomic import atomic_write
from splatmorph.io.axes import FRAMES, USUAL, from_frame, upright
from splatmorph.io.checks import check_count
from splatmorph.io.inflate import Gunzip, check_promise, unzstd
from splatmorph.io.packed import (
    Array,
    Bytes,
    as_bytes,
    drop_largest,
    opacity_bytes,
    read_bytes,
    restore_largest,
    stored_arrays,
    unpacked,
)

MAGIC = b"NGSP"
HEADER = struct.Struct("<4sIIBBBB")
GZIP = b"\x1f\x8b"
READ, WRITTEN, LAST_GZIP, LAST_THREE_BYTE_QUATS, LAST_HALVES = (1, 2, 3, 4), 3, 3, 2, 1
STREAM = struct.Struct("<QQ")
TABLE_AT, V4_HEADER = 16, 32

EXTENDED = 0x2
"""The flag of a file with extensions: records of type, length and bytes."""
RECORD = struct.Struct("<II")
AXES = 0xADBE0003
"""Adobe's extension that names the frame, by its place in this list from 1."""
FRAME_NAMES = (
    *("LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"),
)

MOST_BEYOND = 1 << 20
"""Bytes that may follow the attributes: extensions."""

LARGEST_FIXED = 2**23 - 1
# Some readers refuse others.
FRACTION_BITS = range(1, 25)
COLOUR_RANGE = 0.15
"""Of a byte for each unit of f_dc, about half of SH0: colours may leave 0 to 1."""
QUAT_BITS, QUAT_STEPS = 10, 511
# As the reference rounds them: coarser than a byte, for the sake of the compression.
SH_STEPS = (8, 16, 16)
HIGHEST_DEGREE = len(SH_STEPS)
"""Degree 4 came with version 4."""


@dataclass(frozen=True)
class Header:
    """What a file holds."""

    version: int
    splats: int
    degree: int
    fraction_bits: int
    """Of the positions."""
    flags: int
    streams: int
    """Of version 4; 0 before."""

    @property
    def sizes(self) -> tuple[int, ...]:
        """Bytes of positions, opacities, colours, scales, quaternions and harmonics."""
        quat = 3 if self.version <= LAST_THREE_BYTE_QUATS else 4
        position = 6 if self.version <= LAST_HALVES else 9
        each = (position, 1, 3, 3, quat, 3 * ((self.degree + 1) ** 2 - 1))
        return tuple(self.splats * size for size in each)


def read_spz(path: str | Path) -> Gaussians:
    """Read an ``.spz`` file of any version to 4.

    Raises:
        ReadError: see :func:`splatmorph.io.read`.
    """
    return unpack_spz(read_bytes(Path(path)), Path(path))


def unpack_spz(data: bytes, path: Path) -> Gaussians:
    """The splat in the bytes of an SPZ file; ``path``, where they lie, is for the messages.

    Raises:
        ReadError: see :func:`splatmorph.io.read`.
    """
    with _whole(path):
        header, body, frame = _unzipped(data, path)
    n = header.splats
    begins = accumulate(header.sizes, initial=0)
    positions, alphas, colours, scales, quats, harmonics = (
        np.frombuffer(body, np.uint8, size, begin).reshape(n, -1)
        for begin, size in zip(begins, header.sizes, strict=False)
    )
    sh = np.empty((n, (header.degree + 1) ** 2, 3), np.float32)
    sh[:, 0] = (colours / 255 - 0.5) / COLOUR_RANGE
    # Exact in single precision, which keeps the largest part small.
    sh[:, 1:] = harmonics.reshape(n, -1, 3)
    sh[:, 1:] -= 128
    sh[:, 1:] /= 128
    halves = header.version <= LAST_HALVES
    gaussians = unpacked(
        path,
        means=positions.view("<f2") if halves else _from_fixed(positions, header.fraction_bits),
        quats=_quats(quats),
        log_scales=scales / 16.0 - 10,
        opacities=alphas[:, 0] / 255,
        sh=sh,
    )
    return gaussians if frame is None else from_frame(gaussians, frame)


def spz_layout(path: str | Path) -> str:
    """In words, the version of an ``.spz`` file, and the frame that it says it is in.

    Raises:
        ReadError: see :func:`splatmorph.io.read`.
    """
    path = Path(path)
    with _whole(path):
        header, _, frame = _unzipped(read_bytes(path), path)
    return f"SPZ {header.version} of Niantic" + (f", axes {frame}" if frame else "")


def write_spz(path: str | Path, gaussians: Gaussians, comments: Sequence[str] = ()) -> None:
    """Write version 3, in the order of ``gaussians``; there is no room for ``comments``.

    Positions are as fine as 24 bits allow, harmonics go to degree 3 at most. Axes stay as they
    are; where another than y points up, the file says so.

    Raises:
        WriteError: see :func:`splatmorph.io.write`; or coordinates beyond ±4 194 303.
    """
    gaussians = gaussians.with_sh_degree(min(gaussians.sh_degree, HIGHEST_DEGREE))
    if FRAMES[gaussians.up or "y"] not in FRAME_NAMES:
        gaussians = upright(gaussians, "y")
    means, quats, log_scales, sh = stored_arrays(gaussians, path)
    farthest = float(np.abs(means).max())
    finest = math.floor(math.log2(LARGEST_FIXED / farthest)) if farthest else FRACTION_BITS[-1]
    if finest < FRACTION_BITS[0]:
        raise WriteError(
            f"{path} can't hold a splat at {farthest:.3g}, expected coordinates within "
            f"±{LARGEST_FIXED // 2}: scale the splat down, or write a .ply"
        )
    bits = min(finest, FRACTION_BITS[-1])
    steps = np.repeat(SH_STEPS, [2 * degree + 1 for degree in (1, 2, 3)])
    steps = steps[: sh.shape[1] - 1, None]
    parts = [
        _to_fixed(means, bits),
        opacity_bytes(gaussians),
        as_bytes((0.5 + COLOUR_RANGE * sh[:, 0]) * 255),
        as_bytes((log_scales + 10) * 16),
        _quat_bytes(quats),
        as_bytes(128 + steps * np.round(sh[:, 1:] * 128 / steps)),
    ]
    said = _extensions(gaussians)
    flags = EXTENDED if said else 0
    header = HEADER.pack(MAGIC, WRITTEN, len(gaussians), gaussians.sh_degree, bits, flags, 0)
    body = b"".join([header, *(part.tobytes() for part in parts), said])
    with atomic_write(path) as partial:
        # No time in the file: the same splat gives the same bytes.
        partial.write_bytes(gzip.compress(body, compresslevel=6, mtime=0))


@contextlib.contextmanager
def _whole(path: Path) -> Iterator[None]:
    import zstandard

    try:
        yield
    except (EOFError, ValueError, zlib.error, struct.error, zstandard.ZstdError) as error:
        raise ReadError(
            f"{path} is no whole SPZ file: it is truncated or damaged; download or export it again"
        ) from error


def _unzipped(data: bytes, path: Path) -> tuple[Header, bytes, str | None]:
    """What a file holds, the attributes of all splats one after the other, and its frame if said.

    Extensions follow the attributes, or in version 4 the header.
    """
    if not data.startswith(GZIP):
        header = _header(data, path)
        body = data[HEADER.size :] if header.version <= LAST_GZIP else _inflated(data, header)
    else:
        stream = Gunzip(data)
        header = _header(stream.read(HEADER.size), path)
        body = stream.rest(sum(header.sizes) + MOST_BEYOND)
        if header.version > LAST_GZIP:
            raise ValueError("versions from 4 are no gzip stream")
    if len(body) < sum(header.sizes):
        raise EOFError
    if not header.flags & EXTENDED:
        return header, body, None
    if header.version > LAST_GZIP:
        return header, body, _frame(data[V4_HEADER : struct.unpack_from("<I", data, TABLE_AT)[0]])
    return header, body, _frame(body[sum(header.sizes) :])


def _frame(records: bytes) -> str | None:
    """The frame that extensions name; those of other kinds are passed over."""
    begin = 0
    while begin + RECORD.size <= len(records):
        kind, size = RECORD.unpack_from(records, begin)
        begin += RECORD.size
        if kind == AXES:
            (number,) = struct.unpack_from("<I", records, begin)
            if number > len(FRAME_NAMES):
                raise ValueError(f"axes of kind {number}")
            return FRAME_NAMES[number - 1] if number else None
        begin += size
    return None


def _extensions(gaussians: Gaussians) -> bytes:
    frame = FRAMES[gaussians.up or "y"]
    if frame == USUAL:
        return b""
    return RECORD.pack(AXES, 4) + struct.pack("<I", FRAME_NAMES.index(frame) + 1)


def _header(data: bytes, path: Path) -> Header:
    if not data.startswith(MAGIC):
        raise ReadError(f"{path} is no SPZ file: expected it to start with {MAGIC.decode()}")
    if len(data) < HEADER.size:
        raise EOFError
    _, version, splats, degree, bits, flags, streams = HEADER.unpack_from(data)
    if version not in READ:
        raise ReadError(
            f"{path} is SPZ of version {version}, we read {', '.join(map(str, READ))}: export it "
            "again with another"
        )
    if degree > MAX_SH_DEGREE:
        raise ReadError(
            f"{path} says SH degree {degree}, expected at most {MAX_SH_DEGREE}: it is damaged; "
            "export it again"
        )
    check_count(splats, path)
    header = Header(version, splats, degree, bits, flags, streams)
    check_promise(sum(header.sizes), path)
    return header


def _inflated(data: bytes, header: Header) -> bytes:
    """The attributes of version 4, one after the other; empty ones have no stream."""
    (table,) = struct.unpack_from("<I", data, TABLE_AT)
    begin = table + header.streams * STREAM.size
    sizes = [size for size in header.sizes if size]
    if header.streams < len(sizes):
        raise ValueError("too few streams")
    parts = []
    for i, size in enumerate(sizes):
        packed, promised = STREAM.unpack_from(data, table + i * STREAM.size)
        if promised != size:
            raise ValueError("a stream of another size")
        parts.append(unzstd(data[begin : begin + packed], size))
        begin += packed
    return b"".join(parts)


def _from_fixed(stored: Bytes, bits: int) -> Array:
    low, middle, high = stored.reshape(-1, 3, 3).astype(np.int32).transpose(2, 0, 1)
    whole = low | middle << 8 | (high ^ 0x80) - 0x80 << 16
    return whole / 2.0**bits


def _to_fixed(means: Array, bits: int) -> Bytes:
    whole = np.round(means * 2.0**bits).astype("<i4")
    return np.ascontiguousarray(whole.view(np.uint8).reshape(-1, 3, 4)[..., :3])


def _quats(stored: Bytes) -> Array:
    """wxyz; the file has xyzw, without w before version 3 and without the largest since."""
    if stored.shape[1] == 3:
        xyz = stored / 127.5 - 1
        return restore_largest(np.zeros(len(xyz)), xyz)
    words = np.ascontiguousarray(stored).view("<u4").astype(np.int64)
    fields = words >> np.array([2, 1, 0]) * QUAT_BITS
    sizes = (fields & QUAT_STEPS) / (QUAT_STEPS * math.sqrt(2))
    rest = np.where(fields >> QUAT_BITS - 1 & 1, -sizes, sizes)
    return np.roll(restore_largest(words[:, 0] >> 3 * QUAT_BITS, rest), 1, axis=1)


def _quat_bytes(quats: Array) -> Bytes:
    index, rest = drop_largest(np.roll(quats, -1, axis=1))
    sizes = np.round(np.abs(rest) * math.sqrt(2) * QUAT_STEPS).astype(np.int64)
    fields = np.minimum(sizes, QUAT_STEPS) | (rest < 0) * (QUAT_STEPS + 1)
    words = index << 3 * QUAT_BITS | (fields << np.array([2, 1, 0]) * QUAT_BITS).sum(axis=1)
    return words.astype("<u4").view(np.uint8)
