"""Draw here and in child processes: ``fork_script.py METHOD before|after|during|compiling``.

``during`` our own frames, or while another thread is inside the compiler. Prints the sum of our
picture, and those of the children's.
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from renderer import rasterize
from renderer.cpp import Program, build

PATIENCE = 60


class Number(ctypes.Structure):
    _fields_ = (("number", ctypes.c_int),)


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


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """Another thread is inside the compiler, with a program that no cache holds."""
    inside, building = threading.Event(), build.build

    def announced(source: str) -> object:
        inside.set()
        return building(source)

    build.build = announced
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "new.h").write_text(f"struct Arguments {{ int number; }};  // {folder}\n")
        program = Program(Path(folder), ("new.h",), Number)
        thread = threading.Thread(target=program.available)
        thread.start()
        inside.wait()
        try:
            yield
        finally:
            thread.join()
            build.build = building
    assert program.available()


def main(method: str, when: str) -> None:
    context = multiprocessing.get_context(method)
    if when in ("after", "during"):
        picture_sum()
    sums = []
    meanwhile = {"during": drawing, "compiling": compiling}.get(when, contextlib.nullcontext)
    with meanwhile():
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
