"""A kernel launched once on each of several threads."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

from renderer.quietly import wp


def on_all_threads(kernel: Any, inputs: list[Any], parts: int) -> None:
    """Launch ``kernel`` on the CPU with ``inputs``, the number of ``parts``, and its part."""

    def launch(part: int) -> None:
        wp.launch(kernel, dim=1, inputs=[*inputs, parts, part], device="cpu")

    kernel.module.load(wp.get_device("cpu"))
    others = [_pool(parts).submit(launch, part) for part in range(1, parts)]
    launch(0)
    for other in others:
        other.result()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads)
