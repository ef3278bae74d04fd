"""C++ for this CPU: compiled by Warp's own compiler, run on threads, with one fallback.

    program = Program(Path(__file__).parent, ("lanes.h", "path.h"), Arguments)
    if program.takes(points):          # or .available(), where there are no tensors
        program.run(Arguments(...), cores())
    else:
        ...                            # the plain twin, slower and of the same answer

A program is a ctypes structure of arguments and the headers that make up the body of

    void run(const void* arguments, int parts, int part)

one after the other, each with braces that balance. A header sees everything declared before it:
the structure ``Arguments`` is declared in one of them, and compared with its twin in Python by
the compiler, as is every other structure or size in ``twins``. ``constants`` precede them.

Every program has a plain twin, and the rule which of the two is taken is ``Program.takes``.
Where a program doesn't compile, that is logged once with its file and line, and the twin works.
A compilation that takes long is told to the logger ``renderer.notices``.
"""

from renderer.cpp.program import FEWEST, Program, plain_twins
from renderer.cpp.threads import cores

__all__ = ["FEWEST", "Program", "cores", "plain_twins"]
