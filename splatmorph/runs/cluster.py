"""Tasks on the processes of ``dask.distributed``: some here, or those of somebody's cluster."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import os
import secrets
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, TypeVar

from renderer.cpp import cores
from splatmorph._version import __version__
from splatmorph.errors import MissingExtraError, RunError, WriteError

DEATHS = 5
"""Workers that a task may outlive: one that kills each of its workers is given up."""
PATIENCE = 60.0
"""Seconds to wait for a scheduler to answer, and for its first worker."""

Task = TypeVar("Task")
Done = TypeVar("Done")


@dataclass(frozen=True)
class Lost:
    """What there is instead of a task's result: why it has none."""

    reason: str


@contextlib.contextmanager
def local_cluster(workers: int) -> Iterator[Any]:
    """A client of ``workers`` processes on this machine, which share its cores out.

    None has more of them than OMP_NUM_THREADS says, where it says anything. They speak TLS with a
    key of their own, so that nobody else on the machine gives them tasks.

    Raises ``MissingExtraError``.
    """
    distributed = _distributed()
    each = max(1, min(cores() // workers, _threads_asked()))
    with _quietly(distributed, threads=each), contextlib.ExitStack() as stack:
        with _deaf_to_interrupts():
            cluster = distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                security=True,
                # None means port 8787, and a warning where that is taken.
                dashboard_address="127.0.0.1:0",
                scheduler_kwargs={"dashboard": False},
                silence_logs=logging.CRITICAL,
                # Workers keep no more than a row at a time, and a row may need the machine.
                memory_limit=0,
            )
        client = stack.enter_context(distributed.Client(stack.enter_context(cluster)))
        client.register_worker_callbacks(functools.partial(_share_cores, each))
        yield client


@contextlib.contextmanager
def remote_cluster(scheduler: str, folder: Path) -> Iterator[Any]:
    """A client of the scheduler at an address, once each of its workers is seen to be of use.

    Raises:
        MissingExtraError: dask.distributed is not installed.
        RunError: nobody answers, there are no workers, or one has another version, runs several
            tasks at once, or doesn't see ``folder``.
    """
    distributed = _distributed()
    with _quietly(distributed, threads=1), contextlib.ExitStack() as stack:
        try:
            asyncio.run(_greet(distributed, scheduler))
            client = stack.enter_context(distributed.Client(scheduler, timeout=PATIENCE))
            client.wait_for_workers(1, timeout=PATIENCE)
        except (OSError, ValueError, TimeoutError) as error:
            why = f" ({error})" if str(error) else ""
            raise RunError(
                f"no workers at {scheduler} within {PATIENCE:.0f} s{why}: expected a "
                "scheduler of dask.distributed, tcp://HOST:8786, that has some"
            ) from error
        _check_workers(client, folder)
        yield client


def gather(
    client: Any, work: Callable[[Task], Done], tasks: Sequence[Task]
) -> Iterator[tuple[int, Done | Lost]]:
    """Which task is done, and its result or why there is none, as they come.

    A task whose worker dies is given to another. The results of a caller that goes are let go.
    """
    distributed = _distributed()
    futures = client.map(
        work, tasks, pure=False, key=[f"row-{secrets.token_hex(8)}" for _ in tasks]
    )
    numbers = {future.key: i for i, future in enumerate(futures)}
    try:
        for future in distributed.as_completed(futures):
            try:
                result: Done | Lost = future.result()
            except (distributed.KilledWorker, distributed.CancelledError):
                result = Lost(f"its workers died, {DEATHS} and more of them: give them more memory")
            except Exception as error:  # of a worker, which has said no line of its own
                result = Lost(f"unexpected {type(error).__name__} on a worker: {error}")
            yield numbers[future.key], result
            future.release()
    finally:
        with contextlib.suppress(Exception):
            client.cancel(futures)


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise MissingExtraError("distributed", "cluster", "work on several processes") from error
    return distributed


@contextlib.contextmanager
def _quietly(distributed: Any, threads: int) -> Iterator[None]:
    """Dask as we need it: of its log nothing, and so many threads to the libraries of a worker."""
    import dask

    names = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    log = logging.getLogger("distributed")
    before = log.level
    # Dask sets a worker's variables in our process, and leaves them there.
    environment = dict(os.environ)
    log.setLevel(logging.CRITICAL)
    try:
        with dask.config.set(
            {
                "distributed.nanny.pre-spawn-environ": dict.fromkeys(names, threads),
                "distributed.scheduler.allowed-failures": DEATHS,
                # A row takes seconds: none waits for a busy worker while another is idle.
                "distributed.scheduler.worker-saturation": 1.0,
            }
        ):
            yield
    finally:
        log.setLevel(before)
        for name in os.environ.keys() - environment.keys():
            del os.environ[name]
        os.environ.update(environment)


@contextlib.contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Threads that begin inside, and all processes that they begin, don't hear Ctrl-C.

    A terminal sends it to everybody, and only the caller knows how to end.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Begun in such a thread it would let it hear again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _threads_asked() -> int:
    said = os.environ.get("OMP_NUM_THREADS", "")
    return int(said) if said.isdecimal() else cores()


def _share_cores(each: int, dask_worker: Any) -> None:
    """Keep a worker of ``local_cluster`` to its own cores."""
    if hasattr(os, "sched_setaffinity"):
        free = sorted(os.sched_getaffinity(0))
        first = int(dask_worker.name) * each
        os.sched_setaffinity(0, {free[(first + i) % len(free)] for i in range(each)})


async def _greet(distributed: Any, scheduler: str) -> None:
    """See that it is one: for the answer of anything else, its page say, a client waits forever.

    Raises OSError, ValueError, TimeoutError.
    """
    own = distributed.Security().get_connection_args("client")
    async with asyncio.timeout(PATIENCE), distributed.rpc(scheduler, connection_args=own) as asked:
        await asked.identity()


def _check_workers(client: Any, folder: Path) -> None:
    # Not above: it loads torch, which a new worker needs only once it works.
    from splatmorph.io.atomic import atomic_write

    word = secrets.token_hex(16)
    path = folder.resolve() / f".seen-{word}"
    try:
        with atomic_write(path) as partial:
            partial.write_text(word, encoding="ascii")
        seen = client.run(_look, str(path), word, on_error="return")
    finally:
        path.unlink(missing_ok=True)
    threads = {address: one["nthreads"] for address, one in _workers(client).items()}
    for address, answer in seen.items():
        if isinstance(answer, ImportError):
            raise RunError(
                f"the worker at {address} has no splatmorph: install {__version__} there"
            )
        if isinstance(answer, Exception):
            raise RunError(f"the worker at {address} doesn't answer: {answer}")
        if answer[0] != __version__:
            raise RunError(
                f"the worker at {address} has splatmorph {answer[0]}, expected {__version__}"
            )
        if not answer[1]:
            raise WriteError(
                f"the worker at {address} doesn't see {folder.resolve()}: the table's files and "
                "`out` have to be on storage that all workers share, under the same path"
            )
        if threads.get(address, 1) > 1:
            raise RunError(
                f"the worker at {address} runs {threads[address]} tasks at once, which fight over "
                "its cores: start workers with --nthreads 1, more of them if need be"
            )


def _workers(client: Any) -> dict[str, Any]:
    found: dict[str, Any] = client.scheduler_info(n_workers=-1)["workers"]
    return found


def _look(path: str, word: str) -> tuple[str, bool]:
    try:
        return __version__, Path(path).read_text(encoding="ascii") == word
    except OSError:
        return __version__, False
