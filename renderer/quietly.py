"""Warp, started without a word: ``from renderer.quietly import wp``."""

from __future__ import annotations

import os

import warp as wp

__all__ = ["wp"]


def _start() -> None:
    if hasattr(wp.config, "log_level"):
        wp.config.log_level = wp.LOG_ERROR
    else:  # before Warp 1.12
        setattr(wp.config, "quiet", True)  # noqa: B010 - newer ones have no such name
    # Its C++ side tells file descriptor 2 of a missing CUDA driver, whatever the log level.
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


_start()
