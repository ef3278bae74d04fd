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

from splatmorph.avatars.unpickle import as_array, load_object_array, load_pickle
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
    back = load_pickle(path, path)["array"]
    assert back.dtype == array.dtype
    np.testing.assert_array_equal(back, array)


@pytest.mark.parametrize("layout", ["csc", "csr", "coo"])
@pytest.mark.parametrize("kind", ["matrix", "array"])
def test_sparse_matrices_come_back_dense(tmp_path: Path, layout: str, kind: str) -> None:
    dense = np.random.default_rng(0).normal(size=(5, 9)) * (np.arange(9) % 3 == 0)
    matrix = getattr(scipy.sparse, f"{layout}_{kind}")(dense)
    path = _stored(tmp_path, matrix)
    np.testing.assert_array_equal(as_array(load_pickle(path, path)), dense)


def test_plain_values_come_back(tmp_path: Path) -> None:
    value = {"names": ["a", "b"], "n": np.float64(2.5), "more": OrderedDict(x=1), "some": {1, 2}}
    path = _stored(tmp_path, value)
    assert load_pickle(path, path) == value


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
        load_pickle(path, path)
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
        load_pickle(path, path)


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
        load_pickle(path, path)
    assert str(caught.value).count("\n") == 0


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="No such file"):
        load_pickle(tmp_path / "absent.pkl", "absent.pkl")
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
        as_array(load_pickle(path, path))
