"""The sample pair: two heads that show nobody, made from parameters."""

from __future__ import annotations

from pathlib import Path

from splatmorph.gaussians import Gaussians
from splatmorph.io import write
from splatmorph.landmarks import Landmarks
from splatmorph.samples.bust import portray
from splatmorph.samples.marks import landmarks
from splatmorph.samples.people import INES, OTTO

__all__ = ["sample_pair", "write_sample_pair"]

PAIR = (INES, OTTO)


def sample_pair() -> tuple[tuple[Gaussians, Landmarks], tuple[Gaussians, Landmarks]]:
    """Both people with their landmarks, in metres, y up, facing +z; the same on every call."""
    source, target = ((portray(person), landmarks(person)) for person in PAIR)
    return source, target


def write_sample_pair(folder: str | Path) -> tuple[Path, Path]:
    """Write ``<name>.ply`` and ``<name>.landmarks.json`` of both; returns the PLY files.

    Raises:
        WriteError: a file can't be written.
    """
    folder = Path(folder)
    paths = []
    for person, (gaussians, marks) in zip(PAIR, sample_pair(), strict=True):
        path = folder / f"{person.name}.ply"
        write(path, gaussians)
        marks.write(path.with_name(f"{person.name}.landmarks.json"))
        paths.append(path)
    return paths[0], paths[1]
