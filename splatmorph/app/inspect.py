"""``splatmorph inspect``: what a file is, before anything is done with it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.options import Json


def inspect(
    files: Annotated[tuple[Path, ...], Parameter(help="Splats or avatar directories.")],
    /,
    *,
    json: Json = False,
) -> None:
    """Say what a splat or an avatar is: counts, bounds, frame, landmarks, bad values."""
    raise NotImplementedError
