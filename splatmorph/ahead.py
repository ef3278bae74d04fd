"""Ahead: what takes long is made on a thread while what came before it is used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")


LARGE = 1 << 28
"""Bytes of an item beside which no other is made: using and making it keep all cores busy."""


def ahead(items: Iterable[Item], size: Callable[[Item], int] | None = None) -> Iterator[Item]:
    """The same items in the same order, each made while the one before it is used.

    None is made beside one of a ``size`` above ``LARGE`` bytes, to save the memory.
    What making one raises, comes through in its turn. Whoever stops early waits for at most one
    item that is being made.
    """
    iterator = iter(items)
    with ThreadPoolExecutor(1, "ahead") as thread:
        # What is taken out, and deleted below, isn't held while another is made.
        coming = [thread.submit(_next, iterator)]
        while found := coming.pop().result():
            alone = size is not None and size(*found) > LARGE
            if not alone:
                coming.append(thread.submit(_next, iterator))
            yield from found
            del found
            if alone:
                coming.append(thread.submit(_next, iterator))


def _next(iterator: Iterator[Item]) -> tuple[Item, ...]:
    """The next item, as one of one, or none of none."""
    for item in iterator:
        return (item,)
    return ()
