"""``splatmorph landmarks``: Find landmarks on two splats: faces, and surfaces for the rest."""

from __future__ import annotations

import shlex
from pathlib import Path

from splatmorph.app import console
from splatmorph.app.options import DEFAULT_SEARCH, Out, Overwrite, Searching, Seed, Splat


def landmarks(
    source: Splat,
    target: Splat,
    /,
    *,
    out: Out = None,
    searching: Searching = DEFAULT_SEARCH,
    seed: Seed = 0,
    overwrite: Overwrite = False,
) -> None:
    """Find landmarks on two splats in any pose, and write them as <stem>.landmarks.json.

    They are written beside the splats, where `fit` finds them, or into the folder given by -o.
    Look at them, delete what is wrong, add what is missing: each has a confidence.
    """
    from splatmorph.io.atomic import make_folder
    from splatmorph.registration import find_landmarks
    from splatmorph.registration.masks import without_masked
    from splatmorph.runs.inputs import as_in_file, load_splat

    loaded = load_splat(source), load_splat(target)
    a, b = (without_masked(one.gaussians, one.path) for one in loaded)
    paths = [_path_of(one.path, one.name, out) for one in loaded]
    if out is not None:
        make_folder(out)
    for path in paths:
        console.claim(path, overwrite)
    with console.progress("looking for landmarks") as update:
        found = find_landmarks(
            a,
            b,
            searching.method,
            count=searching.count,
            face_model=searching.face_model,
            crop=searching.crop,
            target_crop=searching.target_crop,
            seed=seed,
            on_step=update,
        )
    for warning in found.warnings:
        console.warn(warning)
    console.say(str(found))
    ends = zip(paths, (found.source, found.target), loaded, strict=True)
    for path, points, one in ends:
        as_in_file(points, one.gaussians).write(path)
        console.say(f"wrote {path}")
    if found.doubtful:
        console.say(how_to_mend(source, target, out))


def _path_of(splat: Path, name: str, folder: Path | None) -> Path:
    beside = splat.parent if folder is None else folder
    return beside / f"{name}.landmarks.json"


def how_to_mend(source: Path, target: Path, folder: Path | None = None, start: str = "") -> str:
    """What to type to look at doubtful landmarks: beside the splats, in a folder, or found anew."""
    words = ["splatmorph", "pick", str(source), str(target)]
    words += ["-o", str(folder)] if folder else []
    words += ["--start", start] if start else []
    return f"to see the pairs and mend them: {shlex.join(words)}"
