"""Splat files in and out: a module a format, found by the file's extension."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from splatmorph.errors import OptionError, ReadError
from splatmorph.gaussians import Gaussians
from splatmorph.io.axes import upright
from splatmorph.io.compressed_ply import write_compressed_ply
from splatmorph.io.dialects import STRANGE_FILES
from splatmorph.io.gltf import gltf_layout, read_gltf, write_gltf
from splatmorph.io.ksplat import ksplat_layout, read_ksplat
from splatmorph.io.ply import ply_layout, read_ply, write_ply
from splatmorph.io.reading import reading
from splatmorph.io.sog import META, read_sog, sog_layout, write_sog
from splatmorph.io.splat import read_splat, write_splat
from splatmorph.io.spz import read_spz, spz_layout, write_spz
from splatmorph.io.usd import UPS, read_usd, usd_layout, write_usd


@dataclass(frozen=True)
class Format:
    """A kind of splat file."""

    read: Callable[[Path], Gaussians]
    write: Callable[[Path, Gaussians, Sequence[str]], None] | None
    """None where the format is only read."""
    layout: Callable[[Path], str]
    """In words, which of its layouts a file has."""
    loses: str = ""
    """What writing costs beside the positions; empty where reading gives back every bit."""
    ups: tuple[str, ...] = ()
    """The axes that the format can have up, to the first of which writing turns what stands on
    another; empty where it has no such notion."""
    animated: bool = False
    """Whether one file can hold a whole sequence."""

    def held(self, gaussians: Gaussians) -> Gaussians:
        """The splat as it stands in a file of this format."""
        if not self.ups or gaussians.up in self.ups:
            return gaussians
        return upright(gaussians, self.ups[0])


ROUNDED = "rotations, scales, colours and opacities are rounded"
GLTF = Format(
    read_gltf,
    write_gltf,
    gltf_layout,
    "rotations, scales and opacities are rounded to floats",
    ups=("y",),
)
USD = Format(
    read_usd,
    write_usd,
    usd_layout,
    "rotations, scales and opacities are rounded to floats",
    ups=tuple(UPS),
    animated=True,
)
SOG = Format(read_sog, write_sog, sog_layout, ROUNDED)
FORMATS = {
    ".ply": Format(read_ply, write_ply, ply_layout),
    ".compressed.ply": Format(read_ply, write_compressed_ply, ply_layout, ROUNDED),
    ".splat": Format(
        read_splat,
        write_splat,
        lambda path: "splat of antimatter15",
        "rotations, colours and opacities are rounded, colour that depends on the view is left out",
    ),
    ".glb": GLTF,
    ".gltf": GLTF,
    ".ksplat": Format(read_ksplat, None, ksplat_layout),
    ".sog": SOG,
    META: SOG,
    ".usd": USD,
    ".usda": USD,
    ".usdc": USD,
    ".usdz": USD,
    ".spz": Format(read_spz, write_spz, spz_layout, ROUNDED),
}
"""By extension."""


def read(path: str | Path) -> Gaussians:
    """Read a splat in world space.

    Args:
        path: a file whose extension names the format.

    Raises:
        LocalFrameError: the file holds a triangle-local avatar.
        ReadError: the file is missing, of another format, damaged, or holds values that no
            renderer can show.
    """
    path = Path(path)
    kind = _format_of(path)
    with reading(path, f"{extension_of(path)} splat"):
        return kind.read(path)


def layout(path: str | Path) -> str:
    """In words, how a splat file is laid out: format, version, dialect, who writes it.

    Raises:
        ReadError: see :func:`read`.
    """
    path = Path(path)
    kind = _format_of(path)
    with reading(path, f"{extension_of(path)} splat"):
        return kind.layout(path)


def write(path: str | Path, gaussians: Gaussians, comments: Sequence[str] = ()) -> None:
    """Write a splat, whole or not at all. Only ``.ply`` keeps every bit; see ``FORMATS``.

    Args:
        path: the extension names the format.
        gaussians: what to write.
        comments: lines for the file's header, where the format has room for them.

    Raises:
        OptionError: no writer for this extension.
        WriteError: the file can't be written, or the format can't hold the splat; a file that
            was there before is untouched.
    """
    path = Path(path)
    if extension_of(path) not in written():
        raise OptionError(
            f"{path} has an extension we don't write; we write {', '.join(written())}"
        )
    kind = FORMATS[extension_of(path)]
    assert kind.write is not None
    kind.write(path, kind.held(gaussians), comments)


def written() -> list[str]:
    """The extensions of the formats that are written."""
    return sorted(extension for extension, kind in FORMATS.items() if kind.write)


def extension_of(path: str | Path) -> str:
    """The extension of a file, lower case: the longest that is a format's, else its last.

    A format may be known by a whole name, as an unbundled SOG is by its ``meta.json``.
    """
    name = Path(path).name.lower()
    ours = [one for one in FORMATS if name == one or (one[0] == "." and name.endswith(one))]
    return max(ours, key=len, default=Path(name).suffix)


def stem_of(path: str | Path) -> str:
    """A file's name without what :func:`extension_of` gives; its folder's if nothing is left."""
    name = Path(path).name
    return name[: len(name) - len(extension_of(path))] or Path(path).resolve().parent.name


def _format_of(path: Path) -> Format:
    if path.is_dir():
        raise ReadError(f"{path} is a directory, expected a splat file ({_known()})")
    extension = extension_of(path)
    if extension in STRANGE_FILES:
        raise ReadError(f"{path} is {STRANGE_FILES[extension]}")
    if extension not in FORMATS:
        raise ReadError(f"{path} has an extension we don't read; we read {_known()}")
    return FORMATS[extension]


def _known() -> str:
    return ", ".join(sorted(FORMATS))


# A module may bring formats of its own: FORMATS there, by extension. No other is loaded for it,
# since some need what may not be installed.
for _file in sorted(Path(__file__).parent.glob("*.py")):
    if _file.stem != "__init__" and "\nFORMATS = {" in _file.read_text(encoding="utf-8"):
        FORMATS |= importlib.import_module(f"{__name__}.{_file.stem}").FORMATS

__all__ = ["FORMATS", "Format", "extension_of", "layout", "read", "stem_of", "write", "written"]
