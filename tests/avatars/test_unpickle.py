"""The restricted reader: what arrays come as is read, everything else is refused."""

from __future__ import annotations

import os
import pickle  # noqa: TID251 - to write what must be refused
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from splatmorph.avatars.stand_ins import as_array
from splatmorph.avatars.unpickle import load_object_array, load_pickle
from splatmorph.errors import ReadError


def _stored(tmp_path: Path, value: Any, protocol: int = 4) -> Path:
    path = tmp_path / "stored.pkl"
    path.write_bytes(pickle.dumps(value, protocol=protocol))
    return path


class _Runs:
    def __init__(self, *call: Any) -> None:
        self.call = call

    def __reduce__(self) -> Any:
        return self.call[0], self.call[1:]


@settings(max_examples=40, deadline=None)
@given(
    array=hnp.arrays(
        st.sampled_from([np.float64, np.float32, np.int64, np.uint32, np.bool_]),
        hnp.array_shapes(max_dims=3, max_side=5),
    ),
    protocol=st.sampled_from([2, 3, 4, 5]),
)
def test_every_array_comes_back_in_every_protocol(
    tmp_path_factory: pytest.TempPathFactory, array: np.ndarray, protocol: int
) -> None:
    path = _stored(tmp_path_factory.mktemp("p"), {"array": array}, protocol)
    back = load_pickle(path)["array"]
    assert back.dtype == array.dtype
    np.testing.assert_array_equal(back, array)


@pytest.mark.parametrize("layout", ["csc", "csr", "coo"])
@pytest.mark.parametrize("kind", ["matrix", "array"])
def test_sparse_matrices_come_back_dense(tmp_path: Path, layout: str, kind: str) -> None:
    dense = np.random.default_rng(0).normal(size=(5, 9)) * (np.arange(9) % 3 == 0)
    matrix = getattr(scipy.sparse, f"{layout}_{kind}")(dense)
    path = _stored(tmp_path, matrix)
    np.testing.assert_array_equal(as_array(load_pickle(path)), dense)


def test_plain_values_come_back(tmp_path: Path) -> None:
    value = {"names": ["a", "b"], "n": np.float64(2.5), "more": OrderedDict(x=1), "some": {1, 2}}
    path = _stored(tmp_path, value)
    assert load_pickle(path) == value


def test_torch_tensors_in_an_object_array_come_back(tmp_path: Path) -> None:
    weights = torch.arange(12, dtype=torch.float64).reshape(3, 4).T
    path = tmp_path / "embedding.npy"
    stored = {"weights": weights, "faces": np.arange(4)}
    np.save(path, np.array(stored, dtype=object), allow_pickle=True)
    back = load_object_array(path)
    np.testing.assert_array_equal(as_array(back["weights"]), weights.numpy())
    np.testing.assert_array_equal(back["faces"], np.arange(4))


@pytest.mark.parametrize("protocol", [0, 2, 4])
@pytest.mark.parametrize(
    "call",
    [
        (os.system, "touch it"),
        (eval, "1 + 1"),
        (getattr, np.zeros(3), "tofile"),
        (np.fromfile, "/etc/hostname"),
        (np.load, "other.npy"),
        (pickle.loads, b"N."),
        (torch.load, "other.pt"),  # noqa: TID251 - to see it refused
        (Path, "/"),
    ],
    ids=lambda call: getattr(call[0], "__name__", "call"),
)
def test_code_is_refused_and_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: tuple[Any, ...], protocol: int
) -> None:
    monkeypatch.chdir(tmp_path)
    path = _stored(tmp_path, {"v_template": _Runs(*call)}, protocol)
    with pytest.raises(ReadError, match="refused") as caught:
        load_pickle(path)
    assert str(caught.value).count("\n") == 0
    assert sorted(file.name for file in tmp_path.iterdir()) == ["stored.pkl"]


@pytest.mark.parametrize(
    "raw",
    [
        # builtins.getattr by a dotted name, through a module that is allowed
        b"\x80\x04\x8c\x05numpy\x94\x8c\x0fndarray.tofile\x94\x93.",
        # a persistent id
        b"\x80\x04\x8c\x04file\x94Q.",
        # the extension registry
        b"\x80\x02\x82\x01.",
        # _reconstructor of a class that is no stand-in
        b"ccopy_reg\n_reconstructor\n(cnumpy\nndarray\nc__builtin__\nobject\nNtR.",
        # BUILD on an allowed function, to change its defaults
        b"ctorch._utils\n_rebuild_tensor_v2\n(N}U\x0c__defaults__N(tstb.",
        # BUILD on a stand-in class, to change it for later pickles
        b"cchumpy.ch\nCh\n(N}U\x08__call__Nstb.",
    ],
    ids=["dotted", "persistent", "extension", "reconstructor", "function", "class"],
)
def test_tricks_are_refused(tmp_path: Path, raw: bytes) -> None:
    path = tmp_path / "trick.pkl"
    path.write_bytes(raw)
    with pytest.raises(ReadError):
        load_pickle(path)


def test_code_in_an_object_array_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "embedding.npy"
    np.save(path, np.array(_Runs(os.system, "touch it"), dtype=object), allow_pickle=True)
    with pytest.raises(ReadError, match="refused"):
        load_object_array(path)


@pytest.mark.parametrize("raw", [b"", b"\x80\x04", b"no pickle at all", b"\x80\x04]\x94(K\x01"])
def test_damage_is_one_line(tmp_path: Path, raw: bytes) -> None:
    path = tmp_path / "damaged.pkl"
    path.write_bytes(raw)
    with pytest.raises(ReadError, match="no whole pickle") as caught:
        load_pickle(path)
    assert str(caught.value).count("\n") == 0


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="No such file"):
        load_pickle(tmp_path / "absent.pkl")
    with pytest.raises(ReadError, match="No such file"):
        load_object_array(tmp_path / "absent.npy")


def test_an_array_of_numbers_is_no_stored_object(tmp_path: Path) -> None:
    np.save(tmp_path / "numbers.npy", np.zeros(3))
    with pytest.raises(ReadError, match="expected a stored object"):
        load_object_array(tmp_path / "numbers.npy")


def test_sparse_indices_out_of_range_are_an_error_not_a_crash(tmp_path: Path) -> None:
    matrix = scipy.sparse.csc_matrix(np.eye(3))
    matrix.indices[0] = 1_000_000
    path = _stored(tmp_path, matrix)
    with pytest.raises(IndexError):
        as_array(load_pickle(path))


ARRAY = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(K\x00tU\x01btR"


PLAIN = b"K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00"


def _dtype(code: bytes, state: bytes = PLAIN) -> bytes:
    sized = bytes([len(code)]) + code
    return b"cnumpy\ndtype\n(U" + sized + b"K\x00K\x01tR(" + state + b"tb"


def _array(shape: bytes, dtype: bytes, content: bytes) -> bytes:
    sized = bytes([len(content)]) + content
    return ARRAY + b"(K\x01(" + shape + b"t" + dtype + b"\x89U" + sized + b"tb"


TOWER = b")q\x00" + b"".join(b"h%c2\x86q%c" % (i, i + 1) for i in range(60))
EXPANDING = b"]q\x00" + b"".join(b"](h%ch%ceq%c" % (i, i, i + 1) for i in range(60))


@pytest.mark.parametrize(
    "raw",
    [
        # bytes of the file as pointers to objects, with flags that say they are none
        _array(b"K\x01", _dtype(b"V8", b"K\x03U\x01|NU\x01atK\x08K\x01K\x00"), bytes(8)),
        _array(b"K\x01", _dtype(b"O8"), bytes(8)),
        # more items than bytes, and sizes that lie
        _array(b"K\x02", _dtype(b"f8"), bytes(8)),
        _array(b"J\xff\xff\xff\xff", _dtype(b"f8"), bytes(8)),
        _array(b"J\xff\xff\xff\x7f", _dtype(b"f8"), b""),
        # names that made arrays before
        b"cnumpy\nndarray\n(J\xff\xff\xff\x7ftR",
        b"cnumpy.core.multiarray\nscalar\n(" + _dtype(b"O8") + b"U\x08" + bytes(8) + b"tR",
        # a memo that would fill the memory, and texts longer than the file
        b"Nr\xff\xff\xff\x7f0j\xff\xff\xff\x7e",
        b"\x96\xff\xff\xff\xff\x0f\x00\x00\x00",
        b"X\xff\xff\xff\xffabc",
        # lists that hold themselves, nest without end, or double at every step
        b"]q\x00h\x00a",
        b"](" * 5000 + b"e" * 5000,
        EXPANDING,
        # keys whose hash takes forever
        b"}(" + TOWER + b"Nu",
    ],
)
def test_no_bytes_become_pointers_and_no_sizes_are_believed(tmp_path: Path, raw: bytes) -> None:
    path = tmp_path / "crafted.pkl"
    path.write_bytes(b"\x80\x02" + raw + b".")
    with pytest.raises((ReadError, ValueError)):
        as_array(load_pickle(path)).astype(np.float64)


def test_a_chumpy_array_that_holds_itself_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cycle.pkl"
    path.write_bytes(b"\x80\x02cchumpy.ch\nCh\n)\x81q\x00}U\x01xh\x00sb.")
    with pytest.raises(ReadError, match="holds itself"):
        load_pickle(path)


def test_a_large_sparse_matrix_of_few_numbers_is_not_made(tmp_path: Path) -> None:
    matrix = scipy.sparse.coo_matrix(([1.0], ([0], [0])), shape=(10**6, 10**6))
    path = _stored(tmp_path, matrix)
    with pytest.raises(ValueError, match="sparse"):
        as_array(load_pickle(path))


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.int64, torch.bool])
def test_tensors_of_every_type_come_back(tmp_path: Path, dtype: torch.dtype) -> None:
    tensor = torch.arange(24).reshape(2, 3, 4).to(dtype)[:, 1:].transpose(0, 2)
    back = load_pickle(_stored(tmp_path, {"t": tensor}))["t"]
    np.testing.assert_array_equal(back, tensor.numpy())


def test_arrays_of_objects_and_of_other_types(tmp_path: Path) -> None:
    objects = np.array([[None, {"a": np.arange(3)}], ["text", 2]], dtype=object)
    stored = {"objects": objects, "words": np.array(["left", "right"]), "n": np.arange(3)}
    back = load_pickle(_stored(tmp_path, stored))
    assert back["objects"].shape == (2, 2)
    np.testing.assert_array_equal(back["objects"][0, 1]["a"], np.arange(3))
    np.testing.assert_array_equal(back["n"], np.arange(3))
    with pytest.raises(ValueError, match="no array"):
        as_array(back["words"])


@pytest.mark.parametrize("protocol", range(6))
def test_pythons_own_values_come_back_in_every_protocol(tmp_path: Path, protocol: int) -> None:
    value = {"a": [1, -2, 1 << 40, 2.5, True, None, ("x", (), "ü\n'")], "b": b"raw", "c": {"d": []}}
    assert load_pickle(_stored(tmp_path, value, protocol)) == value
