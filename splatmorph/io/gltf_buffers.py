"""The containers of glTF: a JSON document and the bytes that its accessors lie in.

Nothing is made that is larger than what the file holds: accessors are views of its bytes.
"""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from splatmorph.errors import ReadError
from splatmorph.io.packed import read_bytes
from splatmorph.io.reading import LARGEST_TEXT

GLB, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
DATA_URI = "data:"

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@dataclass(frozen=True)
class Document:
    """A glTF file."""

    path: Path
    content: dict[str, Any]
    buffers: tuple[bytes, ...]

    def view(self, index: int) -> memoryview:
        """The bytes of a buffer view."""
        described = self.content["bufferViews"][index]
        buffer = self.buffers[described["buffer"]]
        begin, size = described.get("byteOffset", 0), described["byteLength"]
        if not 0 <= begin <= begin + size <= len(buffer):
            raise ValueError("a buffer view ends beyond its buffer")
        return memoryview(buffer)[begin : begin + size]

    def accessor(self, index: int) -> NDArray[Any]:
        """The numbers of an accessor, (n,) or (n, width); integers that are normalized, as parts.

        Raises ``ValueError`` where they lie beyond their bytes.
        """
        described = self.content["accessors"][index]
        if "sparse" in described or "bufferView" not in described:
            raise ValueError("a sparse accessor, which we don't read")
        kind = np.dtype(COMPONENTS[described["componentType"]])
        width, count = WIDTHS[described["type"]], described["count"]
        data = self.view(described["bufferView"])
        begin = described.get("byteOffset", 0)
        stride = self.content["bufferViews"][described["bufferView"]].get(
            "byteStride", width * kind.itemsize
        )
        if count < 1 or begin < 0 or stride < width * kind.itemsize:
            raise ValueError("an accessor makes no sense")
        if begin + (count - 1) * stride + width * kind.itemsize > len(data):
            raise ValueError("an accessor ends beyond its bytes (truncated)")
        numbers: NDArray[Any] = np.ndarray(
            (count, width), kind, data, begin, (stride, kind.itemsize)
        )
        if described.get("normalized") and kind.kind in "iu":
            numbers = np.maximum(numbers / np.iinfo(kind).max, -1)
        return numbers[:, 0] if width == 1 else numbers


def read_document(path: Path) -> Document:
    """Read a ``.glb`` or ``.gltf`` file, known by what it holds.

    Raises:
        ReadError: it is missing, truncated or no glTF of version 2.
    """
    data = read_bytes(path)
    if data[:4] != struct.pack("<I", GLB):
        return _document(path, data, None)
    text, binary = b"", b""
    if len(data) < 12:
        raise ValueError("it ends too early (truncated)")
    _, version, length = struct.unpack_from("<III", data)
    if version != 2:
        raise ReadError(f"{path} is glTF of version {version}, expected 2: export it again")
    if length > len(data):
        raise ValueError("it ends too early (truncated)")
    begin = 12
    while begin + 8 <= length:
        size, kind = struct.unpack_from("<II", data, begin)
        begin += 8
        if begin + size > length:
            raise ValueError("a part of it ends too early (truncated)")
        if kind == JSON_CHUNK:
            text = data[begin : begin + size]
        elif kind == BINARY_CHUNK:
            binary = data[begin : begin + size]
        begin += size
    return _document(path, text, binary)


def _json(text: bytes, path: Path) -> dict[str, Any]:
    # The data of a .gltf may lie in its text, which is then one long word.
    if len(text) > LARGEST_TEXT and DATA_URI.encode() not in text:
        raise ReadError(f"{path} has {len(text) >> 20} MB of JSON, expected at most 16")
    content = json.loads(text.decode("utf-8-sig"))
    if not isinstance(content, dict) or "asset" not in content:
        raise ReadError(f"{path} is no glTF: its JSON has no 'asset'")
    version = str(content["asset"].get("version", ""))
    if not version.startswith("2."):
        raise ReadError(f"{path} is glTF of version {version!r}, expected 2.0: export it again")
    return content


def _document(path: Path, text: bytes, binary: bytes | None) -> Document:
    content = _json(text, path)
    buffers = (
        _fetched(path, one["uri"]) if "uri" in one else binary for one in content.get("buffers", [])
    )
    return Document(path, content, tuple(buffer or b"" for buffer in buffers))


def _fetched(path: Path, uri: str) -> bytes:
    if uri.startswith(DATA_URI):
        return base64.b64decode(uri.partition(",")[2])
    name = unquote(uri)
    if "://" in name or Path(name).is_absolute() or ".." in Path(name).parts:
        raise ReadError(f"{path} keeps its data at {uri[:80]!r}, expected a file beside it")
    return read_bytes(path.parent / name)
