"""Tasks on worker processes: done whoever dies, to the same bits, and only for whom we trust."""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path

import pytest

from splatmorph.errors import MissingExtraError, OutputExistsError, RunError, WriteError
from splatmorph.runs.batch import Record, alone
from splatmorph.runs.cluster import Lost, gather, local_cluster, remote_cluster
from tests.runs.deadly import deaf, once


@pytest.fixture
def dask() -> None:
    pytest.importorskip("distributed")


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_tasks_outlive_their_workers(
    dask: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("splatmorph.runs.cluster.DEATHS", 1)
    with local_cluster(2) as client:
        found = dict(gather(client, once, [(str(tmp_path), i) for i in range(6)]))
    assert sorted(found) == list(range(6))
    for i in (0, 1, 4, 5):
        number, cores = found[i]
        assert number == i
        assert cores <= max(1, (os.cpu_count() or 1) // 2)
    assert isinstance(found[2], Lost)
    assert "its workers died" in found[2].reason
    assert found[3] == Lost("unexpected ZeroDivisionError on a worker: three")


@pytest.mark.skipif(sys.platform == "win32", reason="no masks")
def test_workers_take_no_more_cores_than_asked_and_leave_interrupts_to_us(
    dask: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    with local_cluster(1) as client:
        assert dict(gather(client, once, [(str(tmp_path), 0)])) == {0: (0, 1)}
        assert dict(gather(client, deaf, [0])) == {0: True}
    assert not deaf(0)


def test_a_scheduler_is_used_only_with_workers_of_use(
    dask: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import distributed

    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        dashboard_address="127.0.0.1:0",
        protocol="tcp",
    ) as cluster:
        address = cluster.scheduler_address
        with remote_cluster(address, tmp_path) as client:
            assert dict(gather(client, once, [(str(tmp_path), 0)]))[0][0] == 0
        assert list(tmp_path.iterdir()) == []
        with monkeypatch.context() as patched:
            patched.setattr("splatmorph.runs.cluster._look", lambda *_: ("0.1.0", False))
            with pytest.raises(WriteError, match="doesn't see"), remote_cluster(address, tmp_path):
                pass
            patched.setattr("splatmorph.runs.cluster._look", lambda *_: ("0.0", True))
            with pytest.raises(RunError, match=r"has splatmorph 0\.0"):
                remote_cluster(address, tmp_path).__enter__()
    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=2,
        processes=False,
        dashboard_address="127.0.0.1:0",
        protocol="tcp",
    ) as cluster:
        refused = remote_cluster(cluster.scheduler_address, tmp_path)
        with pytest.raises(RunError, match="2 tasks at once"), refused:
            pass


def test_nobody_at_the_address(dask: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splatmorph.runs.cluster.PATIENCE", 0.2)
    for address in ("tcp://127.0.0.1:9", "nonsense://x"):
        with pytest.raises(RunError, match="no workers at"), remote_cluster(address, tmp_path):
            pass
    with socket.create_server(("127.0.0.1", 0)) as mute:  # as a page is, to whom a scheduler speaks
        address = f"tcp://127.0.0.1:{mute.getsockname()[1]}"
        with pytest.raises(RunError, match="no workers at"), remote_cluster(address, tmp_path):
            pass


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"splatmorph\[cluster\]"), local_cluster(2):
        pass


def test_a_folder_has_one_batch_at_a_time(tmp_path: Path) -> None:
    with alone(tmp_path):
        with pytest.raises(RunError, match="another batch is at work"), alone(tmp_path):
            pass
        with alone(tmp_path / "other"):
            pass
    with alone(tmp_path):
        pass


def test_what_a_row_has_done_is_kept_and_what_is_not_its_own_stays(tmp_path: Path) -> None:
    made = tmp_path / "a.png"
    with Record.of(tmp_path, "a") as record:
        assert not record.has("image", "x", made, False)
        made.touch()  # of somebody else
        with pytest.raises(OutputExistsError, match="`overwrite`"):
            record.has("image", "x", made, False)
        assert not record.has("image", "x", made, True)
        record.begin("image", "x")
        assert not record.has("image", "x", made, False)
        record.end("image", "x")
        assert record.has("image", "x", made, False)
        with pytest.raises(OutputExistsError):
            record.has("image", "y", made, False)
        record.path.write_text("[]")
        with pytest.raises(OutputExistsError):
            record.has("image", "x", made, False)
