"""Read pickles that hold arrays, and nothing else. The one reader of pickle here.

FLAME comes as a pickle, often an old one of chumpy and scipy objects. A pickle names the Python
objects that it wants called, so loading one runs whatever its author liked. This reader knows a
short list of names, all of them ways to build arrays; it needs neither chumpy nor the scipy of the
time, and refuses every other name.
"""

from __future__ import annotations

import collections
import io
import pickle  # noqa: TID251 - the restricted reader itself
import warnings
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import torch
from numpy.typing import NDArray

from splatmorph.errors import ReadError


class StandIn:
    """What an object of a library was pickled with; the library is not needed."""

    def __init__(self, *_: object) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: object) -> None:
        self.state = dict(state) if isinstance(state, dict) else {}


class Chumpy(StandIn):
    """An array of chumpy: its values in ``x``, or ``a`` picked by ``idxs`` (chumpy's Select)."""

    def array(self) -> NDArray[Any]:
        """The values, as chumpy's ``.r`` gives them."""
        if "x" in self.state:
            return as_array(self.state["x"])
        picked = as_array(self.state["a"]).ravel()[as_array(self.state["idxs"])]
        shape = self.state.get("preferred_shape")
        return picked if shape is None else picked.reshape(as_array(shape))


class Sparse(StandIn):
    """A matrix of scipy.sparse; which layout shows in the arrays that it has."""

    def array(self) -> NDArray[Any]:
        """The matrix, dense."""
        data = as_array(self.state["data"])
        rows, columns = (int(n) for n in self.state.get("_shape") or self.state["shape"])
        if "indptr" not in self.state:
            where = self.state.get("coords") or (self.state["row"], self.state["col"])
            return _scatter(data, as_array(where[0]), as_array(where[1]), (rows, columns))
        minor = as_array(self.state["indices"])
        starts = as_array(self.state["indptr"])
        major = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        if self.by_columns:
            return _scatter(data, minor, major, (rows, columns))
        return _scatter(data, major, minor, (rows, columns))

    by_columns = False


class SparseByColumns(Sparse):
    """csc."""

    by_columns = True


class _Call:
    """A function that a pickle may call but not alter (BUILD could set a function's fields)."""

    __slots__ = ("_function",)

    def __init__(self, function: Any) -> None:
        self._function = function

    def __call__(self, *arguments: Any) -> Any:
        return self._function(*arguments)

    def __setstate__(self, state: object) -> None:
        raise pickle.UnpicklingError("it tries to alter a function")


def load_pickle(source: Path | BinaryIO, name: str | Path) -> Any:
    """What a pickle of arrays holds: dicts, lists and numbers, arrays, stand-ins for arrays.

    Arguments:
        source: a path or an open file. Strings of Python 2 are read as latin-1.
        name: of the file, for the messages.

    Raises:
        ReadError: it is no pickle, is damaged, or asks for any other Python object.
    """
    try:
        if isinstance(source, Path):
            with source.open("rb") as stream:
                return _Unpickler(stream, encoding="latin1").load()
        return _Unpickler(source, encoding="latin1").load()
    except OSError as error:
        raise ReadError(f"can't read {name}: {error.strerror or error}") from error
    except _RefusedError as error:
        raise ReadError(
            f"{name} asks for the Python object {error}, which no array needs and which could run "
            "any program: refused; get the file from its original source"
        ) from error
    except Exception as error:  # a damaged pickle can raise anything
        raise ReadError(
            f"{name} is no whole pickle ({_first_line(error)}): download it again"
        ) from error


def load_object_array(path: Path) -> Any:
    """The object in a ``.npy`` file of one Python object, by the same restricted reader.

    Raises:
        ReadError: as ``load_pickle``, or the file is no such ``.npy``.
    """
    try:
        with path.open("rb") as stream:
            version = np.lib.format.read_magic(stream)
            header = (
                np.lib.format.read_array_header_1_0
                if version == (1, 0)
                else np.lib.format.read_array_header_2_0
            )
            _, _, dtype = header(stream)
            if not dtype.hasobject:
                raise ReadError(f"{path} holds an array of {dtype}, expected a stored object")
            return as_array(load_pickle(stream, path)).item()
    except OSError as error:
        raise ReadError(f"can't read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise ReadError(f"{path} is no .npy of one object: {_first_line(error)}") from error


def as_array(value: Any) -> NDArray[Any]:
    """A value out of ``load_pickle`` as a dense array.

    Raises:
        KeyError, ValueError, IndexError: a stand-in that lacks what makes it an array.
    """
    if isinstance(value, Chumpy | Sparse):
        return value.array()
    return np.asarray(value)


class _RefusedError(Exception):
    pass


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        found = _ALLOWED.get((module, name))
        if found is not None:
            return found
        package = module.partition(".")[0]
        if package == "chumpy":
            return Chumpy
        if package == "scipy" and name in _SPARSE:
            return _SPARSE[name]
        raise _RefusedError(f"{module}.{name}")

    def persistent_load(self, pid: Any) -> Any:
        raise _RefusedError(f"with the persistent id {pid!r}")


def _scatter(
    data: NDArray[Any], rows: NDArray[Any], columns: NDArray[Any], shape: tuple[int, int]
) -> NDArray[Any]:
    dense = np.zeros(shape, data.dtype)
    np.add.at(dense, (rows, columns), data)
    return dense


def _reconstruct(kind: Any, base: Any, state: Any) -> Any:
    if not (isinstance(kind, type) and issubclass(kind, StandIn)):
        raise _RefusedError(f"copyreg._reconstructor of {kind!r}")
    return kind()


def _encode(text: str, encoding: str) -> bytes:
    if encoding != "latin1":
        raise _RefusedError(f"_codecs.encode to {encoding!r}")
    return text.encode(encoding)


def _storage(stored: bytes) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch announces the end of the type it wrote
        return torch.load(io.BytesIO(stored), weights_only=True)  # noqa: TID251 - restricted


def _tensor(storage: Any, offset: int, size: Any, stride: Any, *_: object) -> NDArray[Any]:
    flat: Any
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        flat = torch.tensor([], dtype=storage.dtype).set_(storage, offset, size, stride)
    return np.array(flat.numpy())


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


_SPARSE = {
    f"{layout}_{kind}": SparseByColumns if layout == "csc" else Sparse
    for layout in ("csc", "csr", "coo")
    for kind in ("matrix", "array")
}

_ALLOWED: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    ("collections", "OrderedDict"): collections.OrderedDict,
    ("_codecs", "encode"): _Call(_encode),
    ("torch._utils", "_rebuild_tensor_v2"): _Call(_tensor),
    ("torch.storage", "_load_from_bytes"): _Call(_storage),
}
for _core in ("numpy.core", "numpy._core"):
    # numpy's own functions, under the names that its versions gave them.
    _ALLOWED[f"{_core}.multiarray", "_reconstruct"] = _Call(np.zeros(1).__reduce__()[0])
    _ALLOWED[f"{_core}.multiarray", "scalar"] = _Call(np.float64(0).__reduce__()[0])
    _ALLOWED[f"{_core}.numeric", "_frombuffer"] = _Call(np.zeros(1).__reduce_ex__(5)[0])
for _builtins in ("builtins", "__builtin__"):
    _ALLOWED[_builtins, "set"] = set
    _ALLOWED[_builtins, "object"] = object
for _copyreg in ("copyreg", "copy_reg"):
    _ALLOWED[_copyreg, "_reconstructor"] = _Call(_reconstruct)
