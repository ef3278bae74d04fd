"""A function in C++: its source, whether it is to be had and when it is worth it, its runs."""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from renderer.cpp.threads import together

FEWEST = 2000
"""Rows from which loading a program pays."""

SITE = Path(__file__).parents[2]

Launch = Callable[[int, int, int, int, int], None]
"""(address of the arguments, bytes of one, how many, parts, part)"""

_log = logging.getLogger(__name__)
_wanted = True
_failures: set[str] = set()
_building = threading.RLock()
# A child forked while another thread is inside the compiler could never use it again.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_building.acquire,
        after_in_parent=_building.release,
        after_in_child=_building.release,
    )


@contextlib.contextmanager
def plain_twins() -> Iterator[None]:
    """Without any C++, as on a machine where none of it compiles."""
    global _wanted
    before, _wanted = _wanted, False
    try:
        yield
    finally:
        _wanted = before


class Program:
    """C++ that is compiled at its first use.

    Arguments:
        folder: where its headers are.
        headers: their names, in order.
        arguments: the twin of the struct ``Arguments`` that they declare.

    Options:
        constants: C++ that precedes the headers.
        twins: other structs by name; where Python knows only the size of one, its bytes.
        dtype: of the tensors that it computes on, by torch's name.
        differentiable: whether its caller brings gradients along.
    """

    def __init__(
        self,
        folder: Path,
        headers: Sequence[str],
        arguments: type[ctypes.Structure],
        *,
        constants: str = "",
        twins: Mapping[str, type[ctypes.Structure] | int] | None = None,
        dtype: str = "float32",
        differentiable: bool = False,
    ) -> None:
        self.files = [folder / header for header in headers]
        self.constants = constants
        self.twins = {"Arguments": arguments, **(twins or {})}
        self.dtype, self.differentiable = dtype, differentiable
        self._launch: Launch | None = None
        self._tried = False

    def source(self) -> str:
        """The body of the function."""
        pieces = [f'#line 1 "constants of {_shown(self.files[-1])}"', self.constants]
        for file in self.files:
            pieces += [f'#line 1 "{_shown(file)}"', file.read_text(encoding="utf-8")]
        pieces += [f'#line 1 "twins of {_shown(self.files[-1])}"', *_comparisons(self.twins)]
        return "\n".join(pieces) + "\n"

    def available(self) -> bool:
        """Whether it runs here; compiles it when first asked."""
        if _wanted and not self._tried:
            with _building:
                if not self._tried:
                    self._launch = _built(self.source())
                    self._tried = True
        return _wanted and self._launch is not None

    def takes(self, rows: Any, *others: Any, fewest: int = FEWEST) -> bool:
        """The one rule whether C++ or its plain twin works on tensors of torch.

        It does where ``rows`` (m, …) are of its dtype, at least ``fewest`` and like ``others`` on
        the CPU, where none wants a gradient that it wouldn't give, and where it compiles.
        """
        tensors = (rows, *others)
        return (
            len(rows) >= fewest
            and str(rows.dtype) == f"torch.{self.dtype}"
            and all(tensor.device.type == "cpu" for tensor in tensors)
            and (self.differentiable or not any(tensor.requires_grad for tensor in tensors))
            and self.available()
        )

    def run(self, arguments: ctypes.Structure | Sequence[ctypes.Structure], parts: int) -> None:
        """Run in ``parts`` at once. Of several arguments each part does one after the other.

        The caller keeps alive what the arguments point to. Raises RuntimeError where the program
        isn't ``available``.
        """
        if not self.available():
            raise RuntimeError(f"{_shown(self.files[-1])} doesn't run here")
        one_after_other = [arguments] if isinstance(arguments, ctypes.Structure) else arguments
        array = (type(one_after_other[0]) * len(one_after_other))(*one_after_other)
        size, count = ctypes.sizeof(type(one_after_other[0])), len(one_after_other)
        launch = self._launch
        assert launch is not None
        address = ctypes.addressof(array)
        together(lambda part: launch(address, size, count, parts, part), parts)


def _built(source: str) -> Launch | None:
    from renderer.cpp.build import BuildError, build

    try:
        return build(source)
    except BuildError as error:
        if str(error) not in _failures:
            _failures.add(str(error))
            _log.warning("%s: C++ is left out and the slower plain code does its work", error)
        return None


def _shown(file: Path) -> str:
    """The file as the compiler names it: the same wherever the packages are installed."""
    return (file.relative_to(SITE) if file.is_relative_to(SITE) else file).as_posix()


def _comparisons(twins: Mapping[str, type[ctypes.Structure] | int]) -> Iterator[str]:
    """Static assertions that a struct is laid out as Python thinks."""
    for name, twin in twins.items():
        size = twin if isinstance(twin, int) else ctypes.sizeof(twin)
        yield f'static_assert(sizeof({name}) == {size}, "{name} has another size in Python");'
        for field, *_ in [] if isinstance(twin, int) else twin._fields_:
            place = getattr(twin, field).offset
            yield (
                f"static_assert(__builtin_offsetof({name}, {field}) == {place}, "
                f'"{name}::{field} has another place in Python");'
            )
