"""What is made ahead is what is made in turn."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from splatmorph.ahead import LARGE, ahead


def test_order_and_items_are_the_same() -> None:
    assert list(ahead(range(50))) == list(range(50))
    assert list(ahead([None, 0, ""])) == [None, 0, ""]
    assert list(ahead([])) == []


def test_the_next_is_made_while_this_one_is_used_and_no_more_than_that() -> None:
    made = [threading.Event() for _ in range(4)]

    def items() -> Iterator[int]:
        for i, event in enumerate(made):
            event.set()
            yield i

    coming = ahead(items())
    assert next(coming) == 0
    assert made[1].wait(10)
    assert not made[2].wait(0.05)
    coming.close()


def test_an_error_comes_through_in_its_turn_and_an_early_end_leaves_no_thread() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise KeyError("two")

    coming = ahead(items())
    assert next(coming) == 1
    with pytest.raises(KeyError, match="two"):
        next(coming)
    early = ahead(range(5))
    assert next(early) == 0
    early.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("ahead")]


def test_nothing_is_made_beside_what_is_large_until_that_is_gone() -> None:
    gone: list[int] = []

    class Large:
        def __init__(self, number: int) -> None:
            self.number = number

        def __del__(self) -> None:
            gone.append(self.number)

    def items() -> Iterator[Large]:
        for number in range(4):
            assert gone == list(range(number))
            yield Large(number)

    coming = ahead(items(), size=lambda _: LARGE + 1)
    assert [next(coming).number for _ in range(4)] == [0, 1, 2, 3]
