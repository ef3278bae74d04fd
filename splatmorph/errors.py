"""Everything that can be wrong with what the user gave us.

SplatmorphError                 one line: what was found, what was expected, what to do
├── ReadError                   a file that can't be read as what it should be
│   ├── LocalFrameError         a triangle-local avatar where a world-space splat was expected
│   └── TooLargeError           a file that says it is larger than the limit that was given
├── WriteError                  an output that can't be written; nothing half-written is left
│   └── OutputExistsError       an output that is already there
├── LandmarkError               points that don't match, repeat, or lie where they can't
├── FitError                    a fit that can't go on
│   └── NonFiniteError          loss or flow became NaN or infinite
├── RunError                    a run directory that is incomplete, corrupt or foreign
├── OptionError                 a value that an option can't take
└── MissingExtraError           an optional package is needed; the line says how to install it

The command line prints the line and exits with 1; the library raises it.
"""

from __future__ import annotations

LONGEST = 2000


class SplatmorphError(Exception):
    """Base of every error caused by the data or the environment rather than by a bug.

    Its message is one line of printable characters, whatever the names in a file are made of.
    """

    def __init__(self, message: str = "") -> None:
        line = "".join(
            letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in message
        )
        super().__init__(line if len(line) <= LONGEST else f"{line[:LONGEST]}…")


class ReadError(SplatmorphError):
    """A file that can't be read as what it should be."""


class LocalFrameError(ReadError):
    """A triangle-local avatar (GaussianAvatars) where a world-space splat was expected."""


class TooLargeError(ReadError):
    """A file that says it is larger than the limit that was given."""


class WriteError(SplatmorphError):
    """An output that can't be written. Nothing half-written is left behind."""


class OutputExistsError(WriteError):
    """An output that is already there and may not be replaced."""


class LandmarkError(SplatmorphError):
    """Landmarks that don't match, repeat, are too few, or lie where they can't."""


class FitError(SplatmorphError):
    """A fit that can't go on."""


class NonFiniteError(FitError):
    """The loss or the flow became NaN or infinite."""


class RunError(SplatmorphError):
    """A run directory that is incomplete, corrupt or foreign."""


class OptionError(SplatmorphError):
    """A value that an option can't take."""


class MissingExtraError(SplatmorphError):
    """An optional package is needed; the message says how to install it."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        super().__init__(
            f"{purpose} needs the package '{package}', which is not installed: "
            f"run pip install 'splatmorph[{extra}]'"
        )
