"""The same bits whatever the cores: work whose sums are taken in one order."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import torch


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Keep torch to one thread, the only number of them that every machine has.

    Sums and matrix products are split among threads and rounded by how they are split. Also a
    decorator. Our own C++ works on threads nonetheless, in parts of a fixed number.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
