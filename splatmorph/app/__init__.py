"""The command line. Only this package prints, asks or exits."""

from __future__ import annotations

import logging
import os
import re
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import App, CycloptsError, Parameter

from renderer.errors import RenderError
from splatmorph._version import __version__
from splatmorph.app import console
from splatmorph.app.ranges import RangeError, check_ranges
from splatmorph.errors import OptionError, SplatmorphError


def _commands() -> dict[str, str]:
    """What each module here that begins with ``splatmorph NAME`` says it does, unloaded."""
    heads = []
    for file in sorted(Path(__file__).parent.glob("*.py")):
        with file.open(encoding="utf-8") as stream:
            heads.append(stream.readline())
    found = (re.match(r'"""``splatmorph (\w+)``: (.+?)(?:""")?$', head) for head in heads)
    return {match[1]: match[2] for match in found if match}


COMMANDS = _commands()

USAGE, FAILED, TERMINATED = 2, 1, 143

app = App(
    name="splatmorph",
    help="Morph one 3D Gaussian splat into another, by flows.",
    version=__version__,
    help_format="markdown",
)
for _name, _help in COMMANDS.items():
    # By import path: a command loads what it needs when it is called, and not before.
    app.command(f"splatmorph.app.{_name}:{_name}", name=_name, help=_help)


@app.meta.default
def launch(
    *tokens: Annotated[str, Parameter(show=False, allow_leading_hyphen=True)],
    quiet: Annotated[
        bool, Parameter(name=["--quiet", "-q"], negative="", help="Print errors only.")
    ] = False,
    verbose: Annotated[
        bool, Parameter(name="--verbose", negative="", help="Show tracebacks.")
    ] = False,
) -> int | None:
    """Morph one 3D Gaussian splat into another, by flows."""
    console.manner.quiet, console.manner.verbose = quiet, verbose
    console.listen()
    try:
        command, given, _ = app.parse_args(tokens, exit_on_error=False, print_error=True)
    except OptionError as error:
        raise RangeError(console.spoken(error)) from error
    check_ranges(given.arguments)
    code: int | None = command(*given.args, **given.kwargs)
    return code


def run(tokens: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    0 where the user got what was asked, 1 (data), 2 (usage), or what the command returned.
    """
    tokens = sys.argv[1:] if tokens is None else list(tokens)
    if set(tokens) == {"--version", "--verbose"}:
        from splatmorph.app.versions import say_versions

        say_versions()
        return 0
    # The interrupt is the fit's to handle: it keeps the best flow so far.
    app.suppress_keyboard_interrupt = app.meta.suppress_keyboard_interrupt = False
    try:
        if tokens and tokens[0] in COMMANDS:
            # The line of the overview gives way to the command's own text.
            app[tokens[0]].help = None
        code = app.meta(tokens, exit_on_error=False, print_error=True, result_action="return_value")
        return code if isinstance(code, int) else 0
    except CycloptsError:
        return USAGE
    except RangeError as error:
        console.fail(str(error))
        return USAGE
    except (SplatmorphError, RenderError) as error:
        return _failed(console.spoken(error))
    except BrokenPipeError:
        # The reader of our output has gone (`| head`); Python would complain at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except _TerminatedError:
        console.fail("terminated")
        return TERMINATED
    except KeyboardInterrupt:
        console.fail("interrupted")
        return console.INTERRUPTED
    except MemoryError:
        return _failed("out of memory: try a smaller --size, or fewer splats")
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _failed(f"{place}{error.strerror or error}")
    except Exception as error:
        return _failed(
            f"unexpected {type(error).__name__}: {error} "
            "(a bug of ours: please report it with what --verbose prints)"
        )


def main() -> None:
    """The entry point ``splatmorph``."""
    console.speak_plainly()
    # What libraries warn of is no part of our lines.
    warnings.simplefilter("ignore")
    logging.getLogger().addHandler(logging.NullHandler())
    signal.signal(signal.SIGTERM, _terminate)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    code = run()
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError:
        # Full, or gone: said by the exit code, lest Python complains once more.
        sys.stdout = None
        code = code or FAILED
    sys.exit(code)


class _TerminatedError(KeyboardInterrupt):
    """SIGTERM, which is handled as Ctrl-C is."""


def _terminate(*_: object) -> None:
    raise _TerminatedError


class _InterruptedError(KeyboardInterrupt):
    """SIGINT. Where a plain one passes through ``exec`` of a text, as it may while a library loads,
    ``python -m`` notes it as not handled, and ends by the signal in spite of our exit code."""


def _interrupt(*_: object) -> None:
    raise _InterruptedError


def _failed(message: str) -> int:
    console.fail(message)
    if console.manner.verbose:
        traceback.print_exc()
    return FAILED
