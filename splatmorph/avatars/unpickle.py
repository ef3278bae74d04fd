"""Read pickles that hold arrays, and nothing else. The one reader of pickle here.

FLAME comes as a pickle, often an old one of chumpy and scipy objects. A pickle names the Python
objects that it wants called, so loading one runs whatever its author liked. Here each name of a
short list stands for a function of ours that builds arrays out of bytes that are there, types out
of a fixed list; it needs neither chumpy nor the scipy of the time, and refuses every other name.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splatmorph.avatars.opcodes import (
    DamagedError,
    Machine,
    Made,
    Name,
    RefusedError,
    as_dict,
    as_set,
)
from splatmorph.avatars.stand_ins import Chumpy, Sparse, SparseByColumns, StandIn, shape_of
from splatmorph.errors import ReadError

PLAIN = ("b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8")
"""The types that arrays may have, beside objects out of lists."""
DEEPEST = 64
"""Levels of lists in lists, of chumpy arrays of chumpy arrays."""


def load_pickle(path: Path) -> Any:
    """What a pickle of arrays holds: dicts, lists and numbers, arrays, stand-ins for arrays.

    Strings of Python 2 are read as latin-1. No more is made than the file's bytes can stand for.

    Raises:
        ReadError: it is no pickle, is damaged, or asks for any other Python object.
    """
    return _loaded(_bytes(path), path)


def load_object_array(path: Path) -> Any:
    """The object in a ``.npy`` file of one Python object, by the same restricted reader.

    Raises:
        ReadError: as ``load_pickle``, or the file is no such ``.npy``.
    """
    stream = io.BytesIO(_bytes(path))
    try:
        version = np.lib.format.read_magic(stream)
        header = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, _, dtype = header(stream)
    except Exception as error:  # the header is Python's text, and fails in Python's ways
        raise ReadError(f"{path} is no .npy of one object: {_first_line(error)}") from error
    if not dtype.hasobject or shape:
        raise ReadError(f"{path} holds an array of {dtype}, expected a stored object")
    stored = _loaded(stream.read(), path)
    if not (isinstance(stored, np.ndarray) and stored.shape == ()):
        raise ReadError(f"{path} is no .npy of one object: {type(stored).__name__}")
    return stored.item()


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ReadError(f"can't read {path}: {error.strerror or error}") from error


def _loaded(data: bytes, path: Path) -> Any:
    machine = Machine(data, _find)
    try:
        value = machine.load()
        return _Plain(4 * machine.steps + 16).of(value)
    except RefusedError as error:
        raise ReadError(
            f"{path} asks for the Python object {error}, which no array needs and which could run "
            "any program: refused; get the file from its original source"
        ) from error
    except Exception as error:  # a damaged pickle can make any of it fail
        raise ReadError(
            f"{path} is no whole pickle ({_first_line(error)}): download it again"
        ) from error


def _find(module: str, name: str) -> Name:
    package = module.partition(".")[0]
    if package == "chumpy":
        return Name(f"{module}.{name}", Chumpy, is_class=True)
    if package == "scipy" and name in _SPARSE:
        return Name(f"{module}.{name}", _SPARSE[name], is_class=True)
    if (module, name) not in _NAMES:
        raise RefusedError(f"{module}.{name}")
    return Name(f"{module}.{name}", _NAMES[module, name])


class _Plain:
    """Puts arrays in the place of what stands for them, all the way down.

    A part that is held in many places costs a step in each: what holds itself, or would grow by
    repeating its parts, runs out of them.
    """

    def __init__(self, steps: int) -> None:
        self.left = steps

    def of(self, value: Any, depth: int = 0) -> Any:
        self.left -= 1
        if self.left < 0 or depth > DEEPEST:
            raise DamagedError("it holds itself, or nests too deep")
        if isinstance(value, dict):
            return {name: self.of(item, depth + 1) for name, item in value.items()}
        if isinstance(value, list | tuple):
            return type(value)([self.of(item, depth + 1) for item in value])
        if isinstance(value, StandIn):
            plain = type(value)()
            plain.state = self.of(value.state, depth + 1)
            return plain
        if isinstance(value, _Array):
            return value.array(lambda item: self.of(item, depth + 1))
        return value


@dataclass
class _Type(Made):
    """A dtype by its code, such as f8; what else a pickle says of one is not believed."""

    code: str
    order: str = "="

    def build(self, state: object) -> None:
        if isinstance(state, tuple) and len(state) > 1 and state[1] in ("<", ">"):
            self.order = state[1]

    @property
    def is_object(self) -> bool:
        return self.code.startswith("O")

    @property
    def plain(self) -> np.dtype[Any] | None:
        return np.dtype(self.order + self.code) if self.code in PLAIN else None


@dataclass
class _Array(Made):
    """An array to be: numpy makes an empty one and gives it its state."""

    shape: tuple[int, ...] = (0,)
    kind: _Type = field(default_factory=lambda: _Type("f8"))
    by_columns: bool = False
    content: bytes | list[Any] = b""

    def build(self, state: object) -> None:
        if not isinstance(state, tuple):
            raise TypeError("a state that is none")
        shape, kind, by_columns, content = state[-4:]
        self.kind = _kind(kind)
        self.shape, self.by_columns = shape_of(shape), bool(by_columns)
        self.content = content.encode("latin1") if isinstance(content, str) else content

    def array(self, plain: Any) -> Any:
        """The array; a stand-in where its type is none that we read."""
        if isinstance(self.content, list):
            if not self.kind.is_object or math.prod(self.shape) != len(self.content):
                raise ValueError(f"{len(self.content)} objects for {self.shape}")
            objects = np.empty(len(self.content), object)
            for i, item in enumerate(self.content):
                objects[i] = plain(item)
            return objects.reshape(self.shape)
        dtype = self.kind.plain
        if dtype is None:
            return StandIn()
        flat = _from_bytes(self.content, dtype, self.shape)
        return flat.reshape(self.shape[::-1]).T if self.by_columns else flat.reshape(self.shape)


@dataclass(frozen=True)
class _Storage:
    """The numbers of a torch tensor, in a row."""

    dtype: np.dtype[Any]
    content: bytes


def _from_bytes(content: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    count = math.prod(shape)
    if count * dtype.itemsize != len(content):
        raise ValueError(f"{len(content)} bytes for {shape} of {dtype}")
    return np.frombuffer(content, dtype) if count else np.empty(0, dtype)


def _dtype(code: Any, *_: object) -> _Type:
    code = code.decode("latin1") if isinstance(code, bytes) else code
    if not isinstance(code, str):
        raise TypeError("a type that is none")
    return _Type(code.lstrip("<>=|"), code[0] if code[:1] in ("<", ">") else "=")


def _kind(value: Any) -> _Type:
    if not isinstance(value, _Type):
        raise TypeError("an array of no type")
    return value


def _scalar(kind: Any, content: bytes | str) -> Any:
    kind = _kind(kind)
    raw = content.encode("latin1") if isinstance(content, str) else content
    if kind.plain is None:
        raise RefusedError(f"numpy.scalar of type {kind.code:.20}")
    return _from_bytes(raw, kind.plain, (1,))[0]


def _from_buffer(
    content: bytes, kind: Any, shape: Any, order: str, axes: Any = None
) -> _Array | NDArray[Any]:
    kind = _kind(kind)
    if order == "K" and axes is not None and kind.plain is not None:
        flat = _from_bytes(content, kind.plain, shape_of(shape))
        return flat.reshape(shape_of(shape)).transpose(shape_of(axes))
    return _Array(shape_of(shape), kind, order == "F", content)


def _reconstructor(kind: Any, base: Any, state: Any) -> Any:
    if not (isinstance(kind, Name) and kind.is_class):
        raise RefusedError(f"copyreg._reconstructor of a {getattr(kind, 'name', 'thing')}")
    return kind.call()


def _encode(text: str, encoding: str) -> bytes:
    if encoding not in ("latin1", "latin-1"):
        raise RefusedError("_codecs.encode to another encoding")
    return text.encode(encoding)


def _pairs(pairs: Any = ()) -> dict[Any, Any]:
    return as_dict([part for pair in pairs for part in pair])


def _storage(stored: bytes) -> _Storage:
    """What torch's legacy format holds: five pickles, then a count and the numbers."""

    def find(module: str, name: str) -> Name:
        if module == "torch" and name in _STORAGES:
            return Name(name, _STORAGES[name].newbyteorder)
        raise RefusedError(f"{module}.{name}")

    machine = Machine(stored, find, lambda identity: identity)
    *_, (_, kind, _, _, count, _), _ = (machine.load() for _ in range(5))
    if not isinstance(kind, Name):
        raise TypeError("a storage of no type")
    dtype = _STORAGES[kind.name].newbyteorder("<")
    if int.from_bytes(machine.take(8), "little") != count:
        raise ValueError("a storage of another size")
    return _Storage(dtype, machine.take(count * dtype.itemsize))


def _tensor(storage: _Storage, offset: int, size: Any, stride: Any, *_: object) -> NDArray[Any]:
    size, stride = shape_of(size), shape_of(stride)
    values = np.frombuffer(storage.content, storage.dtype)
    if not isinstance(offset, int):
        raise TypeError("an offset that is no number")
    last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True))
    if math.prod(size) > len(values) or not 0 <= offset <= last < len(values):
        raise ValueError(f"a tensor of {size} in {len(values)} numbers")
    steps = [step * values.itemsize for step in stride]
    return np.array(np.lib.stride_tricks.as_strided(values[offset:], size, steps, writeable=False))


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


_SPARSE = {
    f"{layout}_{kind}": SparseByColumns if layout == "csc" else Sparse
    for layout in ("csc", "csr", "coo")
    for kind in ("matrix", "array")
}
_STORAGES = {
    f"{name}Storage": np.dtype(code)
    for name, code in (
        ("Double", "f8"),
        ("Float", "f4"),
        ("Half", "f2"),
        ("Long", "i8"),
        ("Int", "i4"),
        ("Short", "i2"),
        ("Char", "i1"),
        ("Byte", "u1"),
        ("Bool", "b1"),
    )
}

_NAMES: Mapping[tuple[str, str], Any] = {
    ("numpy", "ndarray"): None,
    ("numpy", "dtype"): _dtype,
    ("collections", "OrderedDict"): _pairs,
    ("_codecs", "encode"): _encode,
    ("torch._utils", "_rebuild_tensor_v2"): _tensor,
    ("torch.storage", "_load_from_bytes"): _storage,
    **{
        (f"{core}.{name}", function): call
        for core in ("numpy.core", "numpy._core")
        for name, function, call in (
            ("multiarray", "_reconstruct", lambda *_: _Array()),
            ("multiarray", "scalar", _scalar),
            ("numeric", "_frombuffer", _from_buffer),
        )
    },
    **{
        (builtins, name): call
        for builtins in ("builtins", "__builtin__")
        for name, call in (("set", lambda items=(): as_set(items)), ("object", None))
    },
    **{(copyreg, "_reconstructor"): _reconstructor for copyreg in ("copyreg", "copy_reg")},
}
