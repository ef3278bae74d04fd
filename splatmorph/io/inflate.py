"""Decompression that makes no more than was promised, and believes no promise that is absurd."""

from __future__ import annotations

import zlib
from pathlib import Path

from splatmorph.errors import ReadError

LARGEST_GAIN = 20
"""Times its own size that a compressed splat is believed to hold; real ones reach four."""
ALWAYS_BELIEVED = 16 << 20
"""Bytes that any file may hold, however small it is."""
WINDOW = 1 << 26
"""Bytes that zstandard may look back."""


def check_promise(promised: int, path: Path) -> None:
    """Refuse a file that says it holds far more than its own size can.

    Raises:
        ReadError: ``promised`` bytes are beyond belief.
    """
    size = path.stat().st_size
    if promised > max(ALWAYS_BELIEVED, LARGEST_GAIN * size):
        raise ReadError(
            f"{path} promises {promised >> 20} MB of splats in {size} bytes, expected at most "
            f"{LARGEST_GAIN} times its size: it is damaged, or made to fill the memory"
        )


class Gunzip:
    """A gzip stream that is asked for so many bytes at a time.

    Raises ``zlib.error`` where it is damaged, ``EOFError`` where it ends too early.
    """

    def __init__(self, data: bytes) -> None:
        self._stream = zlib.decompressobj(wbits=31)
        self._left = data

    def read(self, size: int) -> bytes:
        """The next ``size`` bytes."""
        read = self._stream.decompress(self._left, size) if size else b""
        self._left = self._stream.unconsumed_tail
        if len(read) < size:
            raise EOFError
        return read

    def rest(self, most: int) -> bytes:
        """What is left; ``ValueError`` where that is more than ``most`` bytes."""
        read = self._stream.decompress(self._left, most + 1)
        if len(read) > most:
            raise ValueError("more than was promised")
        if not self._stream.eof:
            raise EOFError
        return read


def unzstd(frame: bytes, size: int) -> bytes:
    """The ``size`` bytes of a frame of zstandard.

    Raises ``zstandard.ZstdError`` where it is damaged, ``EOFError`` where it holds fewer.
    """
    import zstandard

    # The frame's own word for its size is not taken.
    with zstandard.ZstdDecompressor(max_window_size=WINDOW).stream_reader(frame) as stream:
        read: bytes = stream.read(size)
    if len(read) < size:
        raise EOFError
    return read
