"""Ahead: what takes long is made on a thread while what came before it is used."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")


def ahead(items: Iterable[Item]) -> Iterator[Item]:
    """The same items in the same order, each made while the one before it is used.

    What making one raises, comes through in its turn. Whoever stops early waits for at most one
    item that is being made.
    """
    iterator = iter(items)
    with ThreadPoolExecutor(1, "ahead") as thread:
        coming = thread.submit(_next, iterator)
        while found := coming.result():
            coming = thread.submit(_next, iterator)
            yield from found
            del found  # or its memory would be held while the one after the next is made


def _next(iterator: Iterator[Item]) -> tuple[Item, ...]:
    """The next item, as one of one, or none of none."""
    for item in iterator:
        return (item,)
    return ()
