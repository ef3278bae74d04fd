"""Damage: what transmission, editors and enemies do to a file."""

from __future__ import annotations

import re
import struct
from random import Random

NUMBERS = (0, 1, -1, 127, 128, 255, 256, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1)
WORDS = (
    b"",
    b"0",
    b"-1",
    b"nan",
    b"-inf",
    b"Infinity",
    b"1e999",
    b"1e-320",
    b"2147483648",
    b"99999999999999999999",
    b"9" * 400,
    b"9" * 5000,
    b"null",
    b"true",
    b"[]",
    b"{}",
    b'"x"',
    b"[" * 200,
    b"[" * 5000,
    b"\xff\xfe",
    b"\x00",
    b"\x1b[2J",
    "é\u2028".encode(),
    b"a" * 200_000,
)


def mutated(data: bytes, other: bytes, random: Random) -> bytes:
    """``data`` with one to a few faults, sometimes with a part of ``other``."""
    for _ in range(random.choice((1, 1, 1, 2, 3, 8))):
        data = random.choice(FAULTS)(data, other, random)
    return data


def _place(data: bytes, random: Random) -> int:
    # Headers decide more than what follows.
    reach = len(data) if random.random() < 0.5 else min(len(data), 600)
    return random.randrange(reach + 1)


def _cut(data: bytes, other: bytes, random: Random) -> bytes:
    return data[: _place(data, random)]


def _flip(data: bytes, other: bytes, random: Random) -> bytes:
    if not data:
        return data
    at = min(_place(data, random), len(data) - 1)
    return data[:at] + bytes([data[at] ^ 1 << random.randrange(8)]) + data[at + 1 :]


def _noise(data: bytes, other: bytes, random: Random) -> bytes:
    at, size = _place(data, random), random.choice((1, 2, 4, 16))
    return data[:at] + random.randbytes(size) + data[at + size :]


def _number(data: bytes, other: bytes, random: Random) -> bytes:
    layout = random.choice(("<B", "<H", "<I", ">I", "<Q", "<d", "<f"))
    value = random.choice(NUMBERS)
    if layout in ("<d", "<f"):
        raw = struct.pack(layout, random.choice((float("nan"), float("inf"), 1e30, 0.0, value)))
    else:
        raw = (value % (1 << 8 * struct.calcsize(layout))).to_bytes(
            struct.calcsize(layout), "big" if layout[0] == ">" else "little"
        )
    at = _place(data, random)
    return data[:at] + raw + data[at + len(raw) :]


def _drop(data: bytes, other: bytes, random: Random) -> bytes:
    at = _place(data, random)
    return data[:at] + data[at + random.choice((1, 2, 4, 30, 300)) :]


def _repeat(data: bytes, other: bytes, random: Random) -> bytes:
    at, size = _place(data, random), random.choice((1, 4, 30, 300))
    return data[:at] + data[at : at + size] * random.choice((2, 3, 40)) + data[at + size :]


def _splice(data: bytes, other: bytes, random: Random) -> bytes:
    return data[: _place(data, random)] + other[_place(other, random) :]


def _word(data: bytes, other: bytes, random: Random) -> bytes:
    """Something else in the place of a number or a word."""
    found = [*re.finditer(rb"[-+.\w]+", data[:20_000])]
    if not found:
        return data
    one = random.choice(found)
    return data[: one.start()] + random.choice(WORDS) + data[one.end() :]


def _digit(data: bytes, other: bytes, random: Random) -> bytes:
    found = [*re.finditer(rb"\d", data[:20_000])]
    if not found:
        return data
    at = random.choice(found).start()
    return data[:at] + str(random.randrange(10)).encode() + data[at + 1 :]


def _line(data: bytes, other: bytes, random: Random) -> bytes:
    """A line dropped, doubled or moved."""
    lines = data.split(b"\n")
    one = lines.pop(random.randrange(len(lines)))
    for _ in range(random.choice((0, 1, 2))):
        lines.insert(random.randrange(len(lines) + 1), one)
    return b"\n".join(lines)


FAULTS = (
    _cut,
    _flip,
    _flip,
    _noise,
    _number,
    _number,
    _drop,
    _repeat,
    _splice,
    _word,
    _word,
    _digit,
    _line,
)
