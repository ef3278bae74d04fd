"""The machine that a pickle is a program for, without its powers.

It runs the opcodes of protocols 0 to 5 that build numbers, text, lists, tuples, dicts and sets. For
the objects that a pickle names it calls what it was told to call, and nothing of Python's. Every
size is checked against the bytes that are there before anything is made of it.
"""

from __future__ import annotations

import codecs
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

MOST_OPCODES = 300_000
"""Arrays take a few dozen each, whatever their size; each opcode can make an object."""

Scalar = str | bytes | int | None


class RefusedError(Exception):
    """The pickle asks for something that no array needs."""


class DamagedError(Exception):
    """The bytes are no whole pickle."""


class Made:
    """What a named call has made: it takes the state that BUILD gives it in a way of its own."""

    def build(self, state: object) -> None:
        """Take the state."""
        raise RefusedError(f"with a state for {type(self).__name__}")


@dataclass(frozen=True)
class Name:
    """A name that a pickle may call."""

    name: str
    call: Callable[..., Any]
    is_class: bool = False
    """Whether objects of it may be made without calling it (NEWOBJ, _reconstructor)."""


class Machine:
    """One pickle after the other out of ``data``."""

    def __init__(
        self,
        data: bytes,
        find: Callable[[str, str], Name],
        persistent: Callable[[Any], Any] | None = None,
    ) -> None:
        """``find`` gives what a module's name stands for, ``persistent`` what an id does."""
        self.data = data
        self.at = 0
        self.steps = 0
        self._find = find
        self._persistent = persistent

    def load(self) -> Any:
        """The next pickle's value, of lists, dicts, tuples, sets, scalars and what names made.

        Raises:
            RefusedError: it asks for other objects.
            DamagedError: it ends too early, or is none.
        """
        self.stack: list[Any] = []
        self.marks: list[list[Any]] = []
        self.memo: dict[int, Any] = {}
        try:
            while (opcode := self.take(1)) != b".":
                self.steps += 1
                if self.steps > MOST_OPCODES:
                    raise DamagedError(f"it takes more than {MOST_OPCODES} steps")
                self._step(opcode)
            return self.stack.pop()
        except (RefusedError, DamagedError):
            raise
        except Exception as error:  # whatever the arguments of a call are made of
            raise DamagedError(f"byte {self.at} makes no sense") from error

    def take(self, count: int) -> bytes:
        """The next ``count`` bytes.

        Raises:
            DamagedError: fewer are left.
        """
        if count > len(self.data) - self.at:
            raise DamagedError("it is cut short")
        self.at += count
        return self.data[self.at - count : self.at]

    def _step(self, opcode: bytes) -> None:
        if opcode in _CONSTANTS:
            self.stack.append(_CONSTANTS[opcode])
        elif opcode in _FIXED:
            layout = _FIXED[opcode]
            self.stack.append(*layout.unpack(self.take(layout.size)))
        elif opcode in _COUNTED:
            count, decode = _COUNTED[opcode]
            self.stack.append(decode(self.take(*count.unpack(self.take(count.size)))))
        elif opcode in _LINES:
            self.stack.append(_LINES[opcode](self._line()))
        elif opcode in _EMPTY:
            self.stack.append(_EMPTY[opcode]())
        elif opcode in _TUPLES:
            size = _TUPLES[opcode]
            items = self.stack[-size:]
            if len(items) < size:
                raise IndexError
            self.stack[-size:] = [tuple(items)]
        elif opcode in _HEADERS:
            self.take(_HEADERS[opcode])
        elif opcode in _DEEDS:
            _DEEDS[opcode](self)
        elif opcode in _REFUSED:
            raise RefusedError(f"by the opcode {_REFUSED[opcode]}")
        else:
            raise ValueError

    def _line(self) -> bytes:
        end = self.data.find(b"\n", self.at)
        if end < 0:
            raise DamagedError("it is cut short")
        return self.take(end + 1 - self.at)[:-1]

    def _marked(self) -> list[Any]:
        items = self.stack
        self.stack = self.marks.pop()
        return items

    def _gather(self, make: Callable[[list[Any]], Any]) -> None:
        items = make(self._marked())
        self.stack.append(items)

    def _mark(self) -> None:
        self.marks.append(self.stack)
        self.stack = []

    def _pop(self) -> None:
        if self.stack:
            self.stack.pop()
        else:
            self._drop()

    def _drop(self) -> None:
        self._marked()

    def _get(self, size: str) -> None:
        self.stack.append(self.memo[self._number(size)])

    def _put(self, size: str) -> None:
        self.memo[self._number(size)] = self.stack[-1]

    def _memoize(self) -> None:
        self.memo[len(self.memo)] = self.stack[-1]

    def _number(self, size: str) -> int:
        if not size:
            return int(self._line())
        (number,) = struct.unpack(size, self.take(struct.calcsize(size)))
        return int(number)

    def _append(self, items: list[Any]) -> None:
        grown = self.stack[-1]
        if not isinstance(grown, list):
            raise TypeError
        grown.extend(items)

    def _set_items(self, items: list[Any]) -> None:
        grown = self.stack[-1]
        if not isinstance(grown, dict):
            raise TypeError
        grown.update(as_dict(items))

    def _add_items(self, items: list[Any]) -> None:
        grown = self.stack[-1]
        if not isinstance(grown, set):
            raise TypeError
        grown.update(as_set(items))

    def _global(self) -> None:
        module, name = (line.decode("utf-8") for line in (self._line(), self._line()))
        self.stack.append(self._find(module, name))

    def _stack_global(self) -> None:
        name, module = self.stack.pop(), self.stack.pop()
        if not (isinstance(name, str) and isinstance(module, str)):
            raise TypeError
        self.stack.append(self._find(module, name))

    def _reduce(self, *, make: bool) -> None:
        arguments, called = self.stack.pop(), self.stack.pop()
        if not (isinstance(called, Name) and isinstance(arguments, tuple)):
            raise RefusedError(f"by a call of a {type(called).__name__}")
        if make and not called.is_class:
            raise RefusedError(f"new {called.name}")
        self.stack.append(called.call(*arguments))

    def _build(self) -> None:
        state, built = self.stack.pop(), self.stack[-1]
        if not isinstance(built, Made):
            raise RefusedError(f"with a state for a {type(built).__name__}")
        built.build(state)

    def _persist(self, name: object) -> None:
        if self._persistent is None:
            raise RefusedError("with a persistent id")
        self.stack.append(self._persistent(name))


def as_dict(items: list[Any]) -> dict[Scalar, Any]:
    """The dict of alternate keys and values."""
    return dict(zip(map(_key, items[::2]), items[1::2], strict=True))


def as_set(items: Iterable[Any]) -> set[Scalar]:
    """The set of these items."""
    return set(map(_key, items))


def _key(value: Scalar) -> Scalar:
    """``value``, where hashing it is quick and can't be made to collide."""
    if isinstance(value, int) and abs(value) < 1 << 31:
        return value
    if not isinstance(value, str | bytes | None):
        raise TypeError("a key that is no text and no number")
    return value


def _whole(text: bytes) -> int | bool:
    if text in (b"00", b"01"):
        return text == b"01"
    return int(text)


def _quoted(text: bytes) -> str:
    if len(text) < 2 or text[:1] not in b"'\"" or text[:1] != text[-1:]:
        raise ValueError
    # What Python's own unpickler decodes Python 2's strings with.
    return codecs.escape_decode(text[1:-1])[0].decode("latin1")


def _latin(raw: bytes) -> str:
    return raw.decode("latin1")


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", "surrogatepass")


def _little(raw: bytes) -> int:
    return int.from_bytes(raw, "little", signed=True)


_CONSTANTS = {b"N": None, b"\x88": True, b"\x89": False}
_FIXED = {
    opcode: struct.Struct(layout)
    for opcode, layout in ((b"K", "<B"), (b"M", "<H"), (b"J", "<i"), (b"G", ">d"))
}
_COUNTED: dict[bytes, tuple[struct.Struct, Callable[[bytes], Any]]] = {
    opcode: (struct.Struct(size), decode)
    for opcode, size, decode in (
        (b"U", "<B", _latin),
        (b"T", "<I", _latin),
        (b"\x8c", "<B", _text),
        (b"X", "<I", _text),
        (b"\x8d", "<Q", _text),
        (b"C", "<B", bytes),
        (b"B", "<I", bytes),
        (b"\x8e", "<Q", bytes),
        (b"\x96", "<Q", bytes),
        (b"\x8a", "<B", _little),
        (b"\x8b", "<I", _little),
    )
}
_LINES: dict[bytes, Callable[[bytes], Any]] = {
    b"I": _whole,
    b"L": lambda text: int(text.removesuffix(b"L")),
    b"F": float,
    b"S": _quoted,
    b"V": lambda text: text.decode("raw-unicode-escape"),
}
_EMPTY: dict[bytes, Callable[[], Any]] = {b"]": list, b"}": dict, b")": tuple, b"\x8f": set}
_TUPLES = {b"\x85": 1, b"\x86": 2, b"\x87": 3}
_HEADERS = {b"\x80": 1, b"\x95": 8}
"""PROTO and FRAME say nothing that is needed."""
_REFUSED = {
    b"i": "INST",
    b"o": "OBJ",
    b"\x92": "NEWOBJ_EX",
    b"\x82": "EXT1",
    b"\x83": "EXT2",
    b"\x84": "EXT4",
    b"\x97": "NEXT_BUFFER",
    b"\x98": "READONLY_BUFFER",
}
_DEEDS: dict[bytes, Callable[[Machine], None]] = {
    b"(": Machine._mark,
    b"0": Machine._pop,
    b"1": Machine._drop,
    b"2": lambda m: m.stack.append(m.stack[-1]),
    b"g": lambda m: m._get(""),
    b"h": lambda m: m._get("<B"),
    b"j": lambda m: m._get("<I"),
    b"p": lambda m: m._put(""),
    b"q": lambda m: m._put("<B"),
    b"r": lambda m: m._put("<I"),
    b"\x94": Machine._memoize,
    b"l": lambda m: m._gather(list),
    b"t": lambda m: m._gather(tuple),
    b"d": lambda m: m._gather(as_dict),
    b"\x91": lambda m: m._gather(as_set),
    b"a": lambda m: m._append([m.stack.pop()]),
    b"e": lambda m: m._append(m._marked()),
    b"s": lambda m: m._set_items([m.stack.pop(-2), m.stack.pop()]),
    b"u": lambda m: m._set_items(m._marked()),
    b"\x90": lambda m: m._add_items(m._marked()),
    b"c": Machine._global,
    b"\x93": Machine._stack_global,
    b"R": lambda m: m._reduce(make=False),
    b"\x81": lambda m: m._reduce(make=True),
    b"b": Machine._build,
    b"P": lambda m: m._persist(m._line()),
    b"Q": lambda m: m._persist(m.stack.pop()),
}
