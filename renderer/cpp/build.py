# mypy: ignore-errors
# Warp's annotations are values, which a type checker can't read; here they are local ones, so that
# they can't be kept as text either.
"""The compiler: Warp's, with what it says made one line, and a word where it takes long."""

import contextlib
import logging
import os
import re
import threading
import time

from renderer.quietly import CaughtStderr, wp

LONG = 1.0
"""Seconds after which whoever waits is told why."""

DIAGNOSTIC = re.compile(r"^(.+?):(\d+):\d+: (?:fatal )?error: (.+)$", re.MULTILINE)

_notices = logging.getLogger("renderer.notices")
_told = False


class BuildError(Exception):
    """C++ that doesn't compile here: one line, with file and line where the compiler knows them."""


def build(source: str):
    """What launches the function with the body ``source``; raises BuildError."""

    @wp.func_native(source)
    def run_natively(arguments: wp.uint64, parts: int, part: int): ...

    @wp.kernel(enable_backward=False, module="unique")
    def run(arguments: wp.uint64, size: int, count: int, parts: int, part: int):
        for i in range(count):
            run_natively(arguments + wp.uint64(i * size), parts, part)

    with CaughtStderr() as caught, _announced(caught):
        try:
            # On the CPU blocks are of one.
            run.module.load(wp.get_device("cpu"), 1)
        except Exception as error:  # Warp raises no other
            reason = _in_one_line(caught.text()) or f"Warp can't compile: {error}"
            raise BuildError(reason) from error
        said = caught.text()
    os.write(2, said)
    return lambda *inputs: wp.launch(run, 1, inputs, device="cpu")


def _in_one_line(said: bytes) -> str:
    found = DIAGNOSTIC.search(said.decode(errors="replace"))
    return f"{found[1]}:{found[2]}: {found[3]}" if found else ""


@contextlib.contextmanager
def _announced(caught: CaughtStderr):
    """Say what takes so long: at once to whoever waits, and at the end how long it was."""

    def tell() -> None:
        global _told
        if not _told:
            _told = True
            with caught.released():
                _notices.warning("compiling kernels, once …")

    begun = time.perf_counter()
    timer = threading.Timer(LONG, tell)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
        taken = time.perf_counter() - begun
        if taken > LONG:
            with caught.released():
                _notices.info("compiling kernels, once: %.0f s", taken)
