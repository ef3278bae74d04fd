"""Warp, started without a word: ``from renderer.quietly import wp``."""

from __future__ import annotations

import atexit
import contextlib
import logging
import os
import shutil
import tempfile
from collections.abc import Iterator
from typing import Self

import warp as wp

__all__ = ["CaughtStderr", "wp"]

_log = logging.getLogger(__name__)


class CaughtStderr:
    """What C++ writes to file descriptor 2, kept from the terminal while in the context."""

    def __enter__(self) -> Self:
        self._file = tempfile.TemporaryFile()
        try:
            self._kept = os.dup(2)
        except OSError:  # a process without a standard error
            self._kept = os.open(os.devnull, os.O_WRONLY)
        os.dup2(self._file.fileno(), 2)
        return self

    def __exit__(self, *_: object) -> None:
        os.dup2(self._kept, 2)
        os.close(self._kept)
        self._file.close()

    def text(self) -> bytes:
        """What was written so far, by any thread."""
        self._file.seek(0)
        return self._file.read()

    @contextlib.contextmanager
    def released(self) -> Iterator[None]:
        """For a moment, the terminal is there."""
        os.dup2(self._kept, 2)
        try:
            yield
        finally:
            os.dup2(self._file.fileno(), 2)


def _start() -> None:
    if hasattr(wp.config, "log_level"):
        wp.config.log_level = wp.LOG_ERROR
    else:  # before Warp 1.12
        setattr(wp.config, "quiet", True)  # noqa: B010 - newer ones have no such name
    # Its C++ side tells of a missing CUDA driver, whatever the log level.
    with CaughtStderr():
        try:
            wp.init()
            with tempfile.TemporaryFile(dir=wp.config.kernel_cache_dir):
                return
        except OSError as error:
            reason = error.strerror
            _keep_kernels_for_now()
    _log.warning(
        "the folder of compiled kernels can't be written (%s): they are kept for this run only",
        reason,
    )


def _keep_kernels_for_now() -> None:
    """In a folder of this process's own."""
    folder = tempfile.mkdtemp(prefix="kernels-")
    owner = os.getpid()

    def remove() -> None:
        if os.getpid() == owner:
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    wp.config.kernel_cache_dir = folder
    wp.init()


_start()
