"""Every reader, with the files that it is given."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from renderer import read_cameras
from splatmorph import io
from splatmorph.avatars.landmark_sets import mesh_landmarks
from splatmorph.avatars.mesh import read_mesh
from splatmorph.avatars.places import find_avatar, is_local
from splatmorph.avatars.rig import read_local
from splatmorph.avatars.stand_ins import as_array
from splatmorph.avatars.track import Track
from splatmorph.avatars.unpickle import load_pickle
from splatmorph.errors import RunError, SplatmorphError
from splatmorph.fitting import FitConfig, fit
from splatmorph.flows import make_flow
from splatmorph.images import Canvas, Picture, read_pair, read_points
from splatmorph.landmarks import Landmarks
from splatmorph.runs.batch import read_rows
from splatmorph.runs.export import export_sequence
from splatmorph.runs.measuring import read_pairs
from splatmorph.runs.request import Request
from splatmorph.runs.run import MANIFEST, REPORT, WEIGHTS, open_run
from splatmorph.runs.state import load_state, save_state
from splatmorph.view.diagnostics import read_history
from tests.fuzz import seeds


@dataclass(frozen=True)
class Reader:
    """A way that a file of the user's comes in."""

    files: Callable[[Path], list[Path]]
    """Makes whole files in a folder."""
    read: Callable[[Path], Any]
    """Reads a damaged one, which has the name of the whole one."""


def _splat(path: Path) -> None:
    io.layout(path)
    io.read(path)


def _local(path: Path) -> None:
    if is_local(path):
        find_avatar(path)
    read_local(path)


def _plane(path: Path) -> None:
    canvas = Canvas(64, 64)
    if read_pair(path, canvas, canvas) is None:
        read_points(path, canvas, None if path.suffix == ".json" else "pixels-xy")


def _cameras(path: Path) -> None:
    if path.name == "images.txt":
        shutil.copy(path.parents[1] / "whole" / "cameras.txt", path.parent)
    read_cameras(path, size=(64, 48))
    read_cameras(path)


def _pickle(path: Path) -> None:
    if path.suffix == ".npy":
        corners = torch.rand(4, 3, dtype=torch.float64)
        mesh_landmarks("70", corners, torch.tensor([[0, 1, 2]]), seeds.splats(), path)
        return
    loaded = load_pickle(path)
    for value in loaded.values() if isinstance(loaded, dict) else [loaded]:
        # What reads FLAME expects these, and no others, from what is no array.
        try:
            as_array(value)
        except (KeyError, ValueError, IndexError, TypeError):
            continue


def _mesh(path: Path) -> None:
    read_mesh(path, path if path.suffix == ".npy" else None, None)


def run_files(folder: Path) -> list[Path]:
    """The files of a fitted run."""
    for name, seed in (("a", 0), ("b", 1)):
        # Above the run, as the damaged one's are.
        io.write(folder.parent / f"{name}.ply", seeds.splats(seed=seed))
        points = torch.rand(6, 3, generator=torch.Generator().manual_seed(seed)) - 0.5
        Landmarks(points, tuple("abcdef")).write(folder.parent / f"{name}.landmarks.json")
    Request.of([folder.parent / f"{name}.ply" for name in "ab"]).fit(folder)
    return sorted(folder.iterdir())


def _run(path: Path) -> None:
    """A run of which one file is damaged; a stranger's, so that its checksums agree."""
    folder = path.parent
    for name in (MANIFEST, REPORT, WEIGHTS, "history.csv"):
        if path.name != name:
            shutil.copy(folder.parent / "whole" / name, folder / name)
    if path.name == WEIGHTS:
        manifest = json.loads((folder / MANIFEST).read_text())
        manifest["weights_sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
        (folder / MANIFEST).write_text(json.dumps(manifest))
    run = open_run(folder)
    read_history(folder)
    try:
        run.morph(blend="union").at(0.5)
    except SplatmorphError as error:
        # What a whole run does is refused, no file.
        raise RunError(f"{folder}: {error}") from error


def state_files(folder: Path) -> list[Path]:
    """What an interrupted fit leaves."""
    kept: list[Any] = []
    flow = make_flow("node", dim=3, field="siren")
    points = [torch.rand(6, 3, generator=torch.Generator().manual_seed(s)) for s in (0, 1)]
    p, q = (Landmarks(point) for point in points)
    fit(flow, p, q, FitConfig(steps=41), on_state=kept.append)
    save_state(folder, 0, kept[0], "asked")
    return sorted(folder.iterdir())


def _state(path: Path) -> None:
    state = load_state(path.parent, 0, "asked")
    flow = make_flow("node", dim=3, field="siren")
    points = [torch.rand(6, 3, generator=torch.Generator().manual_seed(s)) for s in (0, 1)]
    fit(flow, *(Landmarks(point) for point in points), FitConfig(steps=41), resume=state)


class _Still:
    """A morph of nothing, to be exported."""

    def prepare(self, *_: Any) -> None:
        """Nothing."""

    def sequence(self, times: list[float]) -> Any:
        return (seeds.splats(3) for _ in times)


def plan_files(folder: Path) -> list[Path]:
    """What an interrupted export leaves."""

    class Stop(Exception):
        pass

    def stop(done: int) -> None:
        raise Stop

    try:
        export_sequence(_Still(), [0.0, 1.0], folder, on_frame=stop)  # type: ignore[arg-type]
    except Stop:
        return [folder / ".frames.unfinished.json"]
    raise AssertionError


def _plan(path: Path) -> None:
    export_sequence(_Still(), [0.0, 1.0], path.parent, overwrite=True)  # type: ignore[arg-type]


READERS = {
    "splat": Reader(seeds.splat_files, _splat),
    "local": Reader(seeds.splat_files, _local),
    "landmarks": Reader(seeds.landmark_files, Landmarks.read),
    "plane": Reader(seeds.plane_files, _plane),
    "picture": Reader(seeds.picture_files, Picture.read),
    "cameras": Reader(seeds.camera_files, _cameras),
    "pickle": Reader(seeds.pickle_files, _pickle),
    "track": Reader(seeds.track_files, Track.read),
    "mesh": Reader(seeds.mesh_files, _mesh),
    "pairs": Reader(seeds.pair_files, read_pairs),
    "table": Reader(seeds.table_files, read_rows),
    "run": Reader(run_files, _run),
    "state": Reader(state_files, _state),
    "plan": Reader(plan_files, _plan),
}
SLOW = {"run": 10, "state": 200, "plan": 4, "picture": 2}
"""How many times less often than the others they are tried."""

np.seterr(all="ignore")
