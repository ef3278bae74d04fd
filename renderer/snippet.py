# mypy: ignore-errors
# Warp's annotations are values, which a type checker can't read; here they are local ones, so that
# they can't be kept as text either.
"""C++ that Warp compiles for this CPU, run in parts on several threads."""

import ctypes
from functools import cache

from renderer.quietly import wp
from renderer.threads import together


def run_snippet(source: str, arguments: ctypes.Structure | ctypes.Array, parts: int) -> None:
    """Run ``source``, the body of a function of ``arguments`` (an address), ``parts`` and ``part``.

    It declares a struct like that of ``arguments``, in which tensors stand as addresses.
    """
    kernel = _kernel(source)
    # Compiled here, lest two threads do it; on the CPU blocks are of one.
    kernel.module.load(wp.get_device("cpu"), 1)
    inputs = [ctypes.addressof(arguments), parts]
    together(lambda part: wp.launch(kernel, 1, [*inputs, part], device="cpu"), parts)


@cache
def _kernel(source: str):
    @wp.func_native(source)
    def run_natively(arguments: wp.uint64, parts: int, part: int): ...

    @wp.kernel(enable_backward=False, module="unique")
    def run(arguments: wp.uint64, parts: int, part: int):
        run_natively(arguments, parts, part)

    return run
