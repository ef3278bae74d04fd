"""What the renderer raises; every one is a ``ValueError``.

RenderError                 one line: what was found, what was expected, what to do
├── ArgumentError           arrays or numbers that can't be rendered
├── CameraFileError         a camera file that can't be read
└── OutputError             a picture or a video that can't be written
"""

from __future__ import annotations


class RenderError(ValueError):
    """Base of every error the renderer raises on purpose.

    Its message is one line of printable characters, whatever the names in a file are made of.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(
            "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in message)
        )


class ArgumentError(RenderError):
    """Arrays or numbers that can't be rendered."""


class CameraFileError(RenderError):
    """A camera file that can't be read as what it should be."""


class OutputError(RenderError):
    """A picture or a video that can't be written. Nothing half-written is left behind."""
