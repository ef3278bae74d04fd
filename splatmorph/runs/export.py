"""A morph as a folder of splat files, one a time, that a killed process can go on with."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from splatmorph import io
from splatmorph.ahead import ahead
from splatmorph.errors import OutputExistsError, ReadError, WriteError
from splatmorph.gaussians import FAINTEST_DRAWN, Gaussians
from splatmorph.io.atomic import make_folder, write_json
from splatmorph.io.axes import turn_between, upright
from splatmorph.io.ply import ply_size
from splatmorph.io.reading import read_json
from splatmorph.io.usd import HIGHEST_DEGREE, write_animation
from splatmorph.landmarks import Landmarks
from splatmorph.morph import Morph
from splatmorph.morph.agreement import OnStep
from splatmorph.morph.chain import Chain
from splatmorph.morph.ramps import EASES
from splatmorph.timeline import STILL, Timeline

INDEX = "frames.json"
PLAN = ".frames.unfinished.json"
ROW = ("splats", "pruned", "moved")


@dataclass(frozen=True)
class Exported:
    """What an export wrote."""

    folder: Path
    files: tuple[Path, ...]
    pruned: int
    """Splats left out over all frames, being too faint to be drawn."""
    resumed: int
    """Frames that an earlier, interrupted export had written already."""
    moved: float
    """The largest distance in world units that a format's rounding moved a center."""


def export_sequence(
    morph: Morph | Chain,
    times: Sequence[float],
    folder: str | Path,
    *,
    extension: str = ".ply",
    names: Sequence[str] = ("source", "target"),
    prune: bool = True,
    up: str | None = None,
    overwrite: bool = False,
    asked: dict[str, Any] | None = None,
    on_frame: Callable[[int], None] | None = None,
    on_prepare: OnStep | None = None,
) -> Exported:
    """Write ``morph_0000.ply`` … for ``times``, and ``frames.json`` last.

    Args:
        morph: what to write.
        times: t of each frame.
        folder: where to; made if need be.
        extension: of a format that ``splatmorph.io`` writes; only ``.ply`` keeps every bit.
        names: of the splats that it goes through, one at each whole t, for the headers.
        prune: leave out splats too faint to be drawn (alpha below 1/255), except at the inputs.
        up: the axis to turn the splats to, from the one that they have up; None leaves them.
        overwrite: replace an earlier export in ``folder``.
        asked: what tells this export from another one, to resume only what is the same.
        on_frame: called with the number of frames done.
        on_prepare: called before the first, as ``Morph.prepare`` does.

    Raises:
        OutputExistsError: an export is there and ``overwrite`` is off.
        WriteError: a file can't be written; the frames before it are whole, and the same call
            goes on from there.
    """
    folder = make_folder(folder)
    plan = {
        "times": list(times),
        "extension": extension,
        "names": list(names),
        "prune": prune,
        "up": up,
        "asked": asked or {},
    }
    digits = max(4, len(str(len(times) - 1)))
    files = tuple(folder / f"morph_{i:0{digits}d}{extension}" for i in range(len(times)))
    done = _done_before(folder, plan, files, overwrite)
    left = [i for i in range(len(times)) if i not in done]
    coming = [times[i] for i in left]
    morph.prepare(coming, on_prepare)
    frames = ahead(morph.sequence(coming), size=ply_size)
    written: dict[int, dict[str, float]] = {}
    for count, i in enumerate(left):
        # Not kept here while the next but one is made, which may have its memory.
        written[i] = _write_frame(files[i], next(frames), times[i], names, prune, up)
        write_json(folder / PLAN, plan | {"done": done | written})
        if on_frame is not None:
            on_frame(len(done) + count + 1)
    counts = done | written
    rows = [
        {"file": f.name, "t": t} | counts[i]
        for i, (f, t) in enumerate(zip(files, times, strict=True))
    ]
    write_json(folder / INDEX, {"splats": list(names), "frames": rows})
    (folder / PLAN).unlink(missing_ok=True)
    return Exported(
        folder,
        files,
        pruned=sum(int(row["pruned"]) for row in counts.values()),
        resumed=len(done),
        moved=max(row["moved"] for row in counts.values()),
    )


def export_one(
    morph: Morph | Chain,
    t: float,
    path: str | Path,
    *,
    names: Sequence[str] = ("source", "target"),
    prune: bool = True,
    up: str | None = None,
) -> Exported:
    """Write the splat at one time to ``path``, whose extension says the format.

    The other arguments are those of :func:`export_sequence`.

    Raises:
        OptionError, WriteError: see :func:`splatmorph.io.write`.
    """
    path = Path(path)
    (frame,) = morph.sequence([t])
    row = _write_frame(path, frame, t, names, prune, up)
    return Exported(path.parent, (path,), int(row["pruned"]), 0, row["moved"])


def export_animation(
    morph: Morph | Chain,
    times: Sequence[float],
    path: str | Path,
    *,
    timeline: Timeline = STILL,
    names: Sequence[str] = ("source", "target"),
    up: str | None = None,
    on_frame: Callable[[int], None] | None = None,
) -> int:
    """Write the whole morph as one USD file that plays, and return the bytes of the same as PLYs.

    Players interpolate between ``times`` where the splats keep their number (``stable_count``).

    Raises:
        MissingExtraError: usd-core is not installed.
        WriteError: see :func:`splatmorph.io.write`.
    """
    plain = 0

    def frames() -> Iterator[Gaussians]:
        nonlocal plain
        made = ahead(morph.sequence(times), size=ply_size)
        for done in range(1, 1 + len(times)):
            frame = next(made)
            plain += ply_size(frame)
            yield io.FORMATS[io.extension_of(path)].held(upright(frame, up) if up else frame)
            del frame  # or the next but one couldn't have its memory
            if on_frame is not None:
                on_frame(done)

    splats = [one for leg in getattr(morph, "morphs", [morph]) for one in (leg.source, leg.target)]
    degree = min(HIGHEST_DEGREE, max(one.sh_degree for one in splats))
    comment = f"splatmorph t={times[0]:.9g}:{times[-1]:.9g} through {' '.join(names)}"
    write_animation(
        path, frames(), count=len(times), timeline=timeline, degree=degree, comments=[comment]
    )
    return plain


def turned_landmarks(
    morph: Morph, points: Tensor, names: Sequence[str], t: float, path: Path, up: str | None
) -> Landmarks | None:
    """Where a run's landmarks are in what :func:`export_one` writes; None where nothing turns.

    points (k, 3), of the source in the place of its splats.
    """
    frame = morph.at(t)
    turned = io.FORMATS[io.extension_of(path)].held(upright(frame, up) if up else frame)
    if (frame.up or "y") == (turned.up or "y"):
        return None
    t = EASES[morph.ease](t)
    moved = morph.flow.trajectory(points, [t])[0] if t else points
    placed = moved if morph.stay else morph.frame.power(t)(moved)
    absolute = placed.double() + torch.tensor(frame.offset, dtype=torch.float64)
    return Landmarks(turn_between(frame.up or "y", turned.up or "y")(absolute), tuple(names))


def write_measured(path: Path, gaussians: Gaussians, comments: Sequence[str] = ()) -> float:
    """Write a splat, and return how far in world units its format's rounding moved a center.

    Raises:
        OptionError, WriteError: see :func:`splatmorph.io.write`.
    """
    io.write(path, gaussians, comments)
    kind = io.FORMATS[io.extension_of(path)]
    if not kind.loses:
        return 0.0
    stored = io.read(path)
    return float((kind.held(gaussians).absolute_means - stored.absolute_means).norm(dim=1).max())


def _write_frame(
    path: Path, frame: Gaussians, t: float, names: Sequence[str], prune: bool, up: str | None
) -> dict[str, float]:
    """Write one frame; its row in the index, without file and time."""
    leg = min(max(math.floor(t), 0), len(names) - 2)
    between = 0 < t < len(names) - 1 and not float(t).is_integer()
    kept = _drawn(frame) if prune and between else frame
    kept = upright(kept, up) if up else kept
    comment = f"splatmorph t={t:.9g} source={names[leg]} target={names[leg + 1]}"
    moved = write_measured(path, kept, [comment])
    return {"splats": len(kept), "pruned": len(frame) - len(kept), "moved": moved}


def _done_before(
    folder: Path, plan: dict[str, Any], files: Sequence[Path], overwrite: bool
) -> dict[int, dict[str, float]]:
    """Frames of the same export that are there already; makes room where that is allowed."""
    done = _unfinished(folder, plan)
    if done is not None:
        return {i: row for i, row in done.items() if i < len(files) and files[i].is_file()}
    earlier = sorted(f for f in folder.glob("morph_*") if io.extension_of(f) in io.FORMATS)
    if earlier and not overwrite:
        raise OutputExistsError(
            f"{folder} holds frames already ({earlier[0].name} and more): give `overwrite` to "
            "replace them, or another `out`"
        )
    try:
        for file in [*earlier, folder / INDEX, folder / PLAN]:
            file.unlink(missing_ok=True)
    except OSError as error:
        raise WriteError(f"can't replace the frames in {folder}: {error.strerror}") from error
    return {}


def _drawn(gaussians: Gaussians) -> Gaussians:
    return gaussians.select(gaussians.opacities >= FAINTEST_DRAWN)


def _unfinished(folder: Path, plan: dict[str, Any]) -> dict[int, dict[str, float]] | None:
    """The rows of the frames that the same plan has written; None where it is another's."""
    try:
        stored = read_json(folder / PLAN)
        if {name: stored[name] for name in plan} != plan:
            return None
        return {
            int(i): {name: float(row[name]) if name == "moved" else int(row[name]) for name in ROW}
            for i, row in stored["done"].items()
            if i.isdecimal()
        }
    except (ReadError, LookupError, TypeError, ValueError, AttributeError, OverflowError):
        return None
