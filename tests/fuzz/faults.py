"""Files that once did more than be refused, or are of their kind: small, each made here."""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable

import numpy as np
import zstandard

from tests.fuzz.seeds import archive

Maker = Callable[[], bytes]


def _ply(*lines: str, order: str = "binary_little_endian", rows: bytes = b"") -> bytes:
    return "\n".join(["ply", f"format {order} 1.0", *lines, "end_header", ""]).encode() + rows


def _npy(shape: object, descr: object = "<f8", content: bytes = b"") -> bytes:
    header = repr({"descr": descr, "fortran_order": False, "shape": shape}).encode()
    header += b" " * (-(len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + content


def _spz(splats: int, version: int = 3, streams: int = 0, body: bytes = b"") -> bytes:
    return struct.pack("<4sIIBBBB", b"NGSP", version, splats, 3, 12, 0, streams) + body


def _zipped(method: int, name: str, content: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as made:
        made.writestr(name, content)
    return stream.getvalue()


def _png(width: int, height: int, depth: int = 8) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        checked = kind + content
        return struct.pack(">I", len(content)) + checked + struct.pack(">I", zlib.crc32(checked))

    header = struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0)
    row = zlib.compress(bytes(1 << 20))
    parts = (chunk(b"IHDR", header), chunk(b"IDAT", row), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def _cameras(**values: object) -> bytes:
    frames = [{"transform_matrix": np.eye(4).tolist()}]
    return json.dumps({"w": 64, "h": 48, "fl_x": 80, "frames": frames} | values).encode()


def _nested(depth: int) -> bytes:
    return b"[" * depth + b"]" * depth


XYZ = [f"property float {axis}" for axis in "xyz"]
FEW_NORMALS = ["ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
FEW_NORMALS = [f"property float {name}" for name in [*FEW_NORMALS, *(f"rot_{i}" for i in range(4))]]

FAULTS: dict[str, dict[str, Maker]] = {
    "splat": {
        "list.ply": lambda: _ply(
            "element vertex 100000000", "property list uchar int a", order="ascii", rows=b"0\n"
        ),
        "listed.ply": lambda: _ply(
            "element vertex 2147483647", "property list uchar int a", *XYZ, rows=bytes(99)
        ),
        "nothing.ply": lambda: _ply("element vertex 2147483648"),
        "promise.ply": lambda: _ply("element vertex 2147483648", *XYZ, rows=bytes(12)),
        "digits.ply": lambda: _ply(f"element vertex {'9' * 5000}", *XYZ),
        "negative.ply": lambda: _ply("element vertex -1", *XYZ),
        "twice.ply": lambda: _ply("element vertex 1", *XYZ, *XYZ, rows=bytes(24)),
        "endless.ply": lambda: b"ply\nformat ascii 1.0\n" + b"comment \n" * 200_000,
        "chunks.ply": lambda: _ply(
            "element chunk 200000",
            *(f"property float {end}_{axis}" for end in ("min", "max") for axis in "xyz"),
            "element vertex 1",
            "property uint packed_position",
            rows=bytes(200_000 * 24 + 4),
        ),
        "promise.spz": lambda: gzip.compress(_spz(2**31 - 1)),
        "plain.spz": lambda: _spz(2**32 - 1, body=bytes(100)),
        "zeros.spz": lambda: gzip.compress(_spz(1_000_000, body=bytes(65_000_000))),
        "more.spz": lambda: gzip.compress(_spz(1, body=bytes(65_000_000))),
        "four.spz": lambda: _spz(
            2**32 - 1, 4, 6, struct.pack("<I", 20) + bytes(96) + zstandard.compress(bytes(999))
        ),
        "empty.ply": lambda: b"",
        "empty.spz": lambda: b"",
        "empty.splat": lambda: b"",
    },
    "local": {
        "comment.ply": lambda: (
            _ply("comment binding_0 is not here", "element vertex 1", *XYZ) + bytes(12)
        ),
    },
    "landmarks": {
        "large.npy": lambda: _npy((100_000_000, 3)),
        "larger.npy": lambda: _npy((2**40, 3)),
        "negative.npy": lambda: _npy((-1, 3)),
        "float.npy": lambda: _npy((2.5, 3)),
        "object.npy": lambda: _npy((), "|O", b"cos\nsystem\n(S'true'\ntR."),
        "text.npy": lambda: _npy((3,), "<U8", bytes(96)),
        "wide.npy": lambda: _npy((1, 3), "(1000000,)<f8"),
        "nothing.npy": lambda: b"",
        "unclosed.npy": lambda: b"\x93NUMPY\x01\x00\x10\x00{'descr': (((((((",
        "none.npz": lambda: zipfile_of_nothing(),
        "cut.npz": lambda: archive({"points": np.zeros((9, 3))})[:200],
        "object.npz": lambda: archive({"points": np.zeros((9, 3)), "names": np.array([None] * 9)}),
        "letters.npz": lambda: archive(
            {"points": np.eye(4, 3), "names": np.full(4, 0x7FFFFFFF, "<u4").view("<U1")}
        ),
        "method.npz": lambda: _zipped(
            zipfile.ZIP_LZMA, "points.npy", _npy((9, 3), "<f8", bytes(216))
        ),
        "deep.json": lambda: _nested(100_000),
        "deep64.json": lambda: _nested(80),
        "digits.json": lambda: b"[[%s, 0, 0]]" % (b"9" * 5000),
        "large.json": lambda: b"[[1e400, 0, 0], [%s, 0, 0]]" % (b"9" * 400),
        "twice.json": lambda: b'{"points": {"a": [0, 0, 0], "a": [0, 0, 1]}}',
        "control.json": lambda: json.dumps({"\x1b[2J\n": [0, 0, float("nan")]}).encode(),
        "cell.csv": lambda: b"x,y,z\n1,2," + b"3" * 140_000,
        "entities.pp": lambda: (
            b'<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/hostname">]><a>&b;</a>'
        ),
        "laughs.pp": lambda: b"<!DOCTYPE a [<!ENTITY b 'ha'>]><a>&b;</a>",
    },
    "plane": {
        "digits.tem": lambda: b"9" * 5000,
        "negative.tem": lambda: b"-3\n1 2\n",
        "digits.pts": lambda: b"n_points: %s\n{\n1 2\n}" % (b"9" * 5000),
        "many.pts": lambda: b"n_points: 1 " * 100_000,
        "none.tem": lambda: b"",
    },
    "picture": {
        "wide.png": lambda: _png(30_000, 30_000, 16),
        "wider.png": lambda: _png(2**31 - 1, 1),
        "cut.png": lambda: _png(1000, 1000)[:80],
        "wide.jpg": lambda: bytes.fromhex("ffd8ffc0001108fde8fde803012200021101031101"),
        "none.png": lambda: b"",
        "program.png": lambda: b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n",
    },
    "cameras": {
        "flat.json": lambda: _cameras(camera_angle_x=0, fl_x=0),
        "none.json": lambda: _cameras(w=0, h=0),
        "infinite.json": lambda: _cameras(w=float("inf")),
        "huge.json": lambda: _cameras(w=10**400),
        "large.json": lambda: _cameras(w=10**9, h=10**9),
        "singular.json": lambda: _cameras(frames=[{"transform_matrix": [[0] * 4] * 4}]),
        "words.json": lambda: _cameras(frames="none"),
        "deep.json": lambda: _nested(100_000),
    },
    "track": {
        "names.npz": lambda: archive({"expr": np.array("none"), "jaw_pose": np.zeros((1, 3))}),
        "text.npz": lambda: archive({"expr": np.array([b"a"]), "jaw_pose": np.array([b"b"])}),
        "large.npz": lambda: _zipped(
            zipfile.ZIP_DEFLATED, "dynamic_offset.npy", _npy((10**6, 5143, 3), "<f4")
        ),
        "none.npz": lambda: zipfile_of_nothing(),
    },
    "mesh": {
        "list.ply": lambda: _ply(
            "element vertex 100000000", "property list uchar int a", order="ascii", rows=b"0\n"
        ),
        "words.obj": lambda: b"v a b c\nf 1 2 3\n",
        "far.obj": lambda: b"v 0 0 0\nf 1 2 999999999\n",
        "farther.obj": lambda: b"v 0 0 0\nvt 0 0\nvn 0 0 1\nf 1/1/1 1/1/1 2147483648/1/1\n",
        "large.npy": lambda: _npy((100_000_000, 3)),
    },
    "pairs": {"cell.csv": lambda: b"1,2,3,4,5," + b"6" * 200_000 + b"x", "none.npz": lambda: b"PK"},
    "table": {"cell.csv": lambda: b"source,target\n" + b"a" * 200_000, "none.csv": lambda: b""},
}
"""By reader and file name."""


def zipfile_of_nothing() -> bytes:
    """An archive without entries."""
    return b"PK\x05\x06" + bytes(18)
