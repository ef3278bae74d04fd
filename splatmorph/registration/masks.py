"""What registration leaves out of a splat: a plinth, a stand, another person's hand.

A mask is a list of loops, each a polygon in the picture of a camera: what lies in the cone behind
one is left out, however deep. Beside the splat it is ``<stem>.mask.json``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from splatmorph.errors import OptionError, ReadError
from splatmorph.gaussians import Gaussians
from splatmorph.io import stem_of
from splatmorph.io.atomic import write_json
from splatmorph.io.reading import read_json, reading

Array = NDArray[np.float64]

MOST_CORNERS, MOST_LOOPS = 2000, 100


@dataclass(frozen=True)
class Loop:
    """A polygon drawn over a picture."""

    viewmat: Array
    """(4, 4) world → camera, OpenCV axes."""
    polygon: Array
    """(k, 2) slopes x/z, y/z of the corners: pixels of a camera of focal length 1."""

    def __post_init__(self) -> None:
        shapes = self.viewmat.shape == (4, 4), self.polygon.ndim == 2 and self.polygon.shape[1] == 2
        if not all(shapes) or not 3 <= len(self.polygon) <= MOST_CORNERS:
            raise OptionError(f"a loop has 3 to {MOST_CORNERS} corners and a camera")
        if not (np.isfinite(self.viewmat).all() and np.isfinite(self.polygon).all()):
            raise OptionError("a loop has numbers that are not finite")

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Whether each of the world points (n, 3) lies in the cone."""
        from matplotlib.path import Path as Polygon

        seen = points @ self.viewmat[:3, :3].T + self.viewmat[:3, 3]
        ahead = seen[:, 2] > 0
        depth = np.where(ahead, seen[:, 2], 1.0)
        return ahead & Polygon(self.polygon).contains_points(seen[:, :2] / depth[:, None])


@dataclass(frozen=True)
class Mask:
    """The loops of one splat, in the coordinates of its file."""

    loops: tuple[Loop, ...] = ()

    def kept(self, gaussians: Gaussians) -> Gaussians:
        """The splats whose centers lie in no loop.

        Raises:
            OptionError: none is left.
        """
        if not self.loops:
            return gaussians
        points = gaussians.means.double().numpy(force=True) + np.asarray(gaussians.offset)
        out = np.any([loop.holds(points) for loop in self.loops], axis=0)
        if out.all():
            raise OptionError("the mask leaves no splat: draw it anew")
        return gaussians.select(torch.from_numpy(np.flatnonzero(~out)))

    @staticmethod
    def path_beside(splat: str | Path) -> Path:
        """Where the mask of a splat is kept."""
        splat = Path(splat)
        return splat.with_name(f"{stem_of(splat)}.mask.json")

    @staticmethod
    def read(path: str | Path) -> Mask:
        """Read what ``write`` wrote.

        Raises:
            ReadError: it is missing, damaged or something else.
        """
        stored = read_json(Path(path), "mask")
        with reading(Path(path), "mask"):
            loops = tuple(map(_loop_of, stored["leave_out"]))
            if len(loops) > MOST_LOOPS:
                raise ReadError(f"{path} holds {len(loops)} loops, expected at most {MOST_LOOPS}")
            return Mask(loops)

    def write(self, path: str | Path) -> None:
        """Write ``.json``, whole or not at all.

        Raises:
            WriteError: the file can't be written.
        """
        write_json(path, {"leave_out": [_loop_json(loop) for loop in self.loops]})


def without_masked(gaussians: Gaussians, splat: str | Path) -> Gaussians:
    """What registration sees of the splat that was read from a path: less its mask, if any.

    Raises:
        ReadError: the mask beside it can't be read.
        OptionError: it leaves nothing.
    """
    path = Mask.path_beside(splat)
    return Mask.read(path).kept(gaussians) if path.is_file() else gaussians


def _loop_json(loop: Loop) -> dict[str, Any]:
    return {"viewmat": loop.viewmat.tolist(), "polygon": loop.polygon.tolist()}


def _loop_of(stored: Mapping[str, Iterable[Sequence[float]]]) -> Loop:
    return Loop(
        np.array(list(stored["viewmat"]), np.float64), np.array(list(stored["polygon"]), np.float64)
    )
