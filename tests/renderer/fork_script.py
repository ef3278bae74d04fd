"""Draw here and in child processes: ``fork_script.py METHOD before|after|during`` our own frames.

Prints the sum of our picture, and those of the children's.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import sys
import threading
from collections.abc import Iterator

import numpy as np

from renderer import rasterize

PATIENCE = 60


def picture_sum(size: int = 64) -> float:
    viewmat = np.eye(4)
    viewmat[2, 3] = 4
    rgb, _, _ = rasterize(
        np.zeros((4, 3)),
        np.ones((4, 4)),
        np.full((4, 3), 0.2),
        np.full(4, 0.5),
        np.ones((4, 1, 3)),
        viewmat,
        [[size, 0, size / 2], [0, size, size / 2], [0, 0, 1]],
        size,
        size,
        threads=2,
    )
    return float(rgb.sum())


def child(answers: multiprocessing.SimpleQueue[float]) -> None:
    answers.put(picture_sum())


@contextlib.contextmanager
def drawing() -> Iterator[None]:
    """Another thread draws all the time."""
    stopped = threading.Event()

    def draw() -> None:
        while not stopped.is_set():
            picture_sum(512)

    thread = threading.Thread(target=draw)
    thread.start()
    try:
        yield
    finally:
        stopped.set()
        thread.join()


def main(method: str, when: str) -> None:
    context = multiprocessing.get_context(method)
    if when != "before":
        picture_sum()
    sums = []
    with drawing() if when == "during" else contextlib.nullcontext():
        for _ in range(3 if when == "during" else 1):
            answers = context.SimpleQueue()
            process = context.Process(target=child, args=(answers,))
            process.start()
            process.join(PATIENCE)
            if process.exitcode != 0:
                process.kill()
                sys.exit(f"the child ended with {process.exitcode}")
            sums.append(answers.get())
    print(picture_sum(), *sums)


if __name__ == "__main__":
    main(*sys.argv[1:])
