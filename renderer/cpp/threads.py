"""A pool of threads for programs: Warp runs a kernel on one thread of the CPU."""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait


def cores() -> int:
    """The cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def together(task: Callable[[int], object], threads: int) -> None:
    """task(0) … task(threads - 1) at once."""
    if threads == 1:
        task(0)
        return
    shares = [_pool(threads).submit(task, number) for number in range(threads)]
    try:
        wait(shares)
    finally:  # an interrupt must not free what the threads still write to
        wait(shares)
    for share in shares:
        share.result()


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """So many threads; where they are as many as the cores, one on each.

    Left to itself, the system at times keeps two of them on one core for a whole frame.
    """
    free = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_setaffinity") else []

    def stay_on_one_core() -> None:
        if len(free) == threads:
            with contextlib.suppress(OSError):
                os.sched_setaffinity(0, {free[next(numbers)]})

    numbers = itertools.count()
    return ThreadPoolExecutor(threads, "native", stay_on_one_core)


# Of a process only the thread that forks goes on in its child.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)
