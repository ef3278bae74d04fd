"""What the renderer raises; every one is a ``ValueError``.

RenderError                 one line: what was found, what was expected, what to do
├── ArgumentError           arrays or numbers that can't be rendered
├── CameraFileError         a camera file that can't be read
└── OutputError             a picture or a video that can't be written
"""

from __future__ import annotations


class RenderError(ValueError):
    """Base of every error the renderer raises on purpose."""


class ArgumentError(RenderError):
    """Arrays or numbers that can't be rendered."""


class CameraFileError(RenderError):
    """A camera file that can't be read as what it should be."""


class OutputError(RenderError):
    """A picture or a video that can't be written. Nothing half-written is left behind."""
