"""``splatmorph bake``: Write a rigged avatar as a plain splat."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.options import Out, Overwrite
from splatmorph.errors import OptionError

if TYPE_CHECKING:
    from splatmorph.avatars import Avatar, Track

AvatarInput = Annotated[
    Path, Parameter(help="Its splat file, the directory of that, or the model directory.")
]
Frame = Annotated[
    int | None,
    Parameter(help="Pose as in this frame of the track; the canonical pose if not given."),
]
PoseFrom = Annotated[
    Path | None,
    Parameter(help="Take the pose from this avatar's track, or from a flame_param.npz."),
]
LandmarkSet = Annotated[str, Parameter(help="Of FLAME: 70, 254, dense.")]
LandmarkCount = Annotated[
    int | None, Parameter(help="Keep at most this many landmarks, spread evenly.")
]
FlameOption = Annotated[
    Path | None,
    Parameter(name="--flame", help="The FLAME model or its folder; else $SPLATMORPH_FLAME."),
]
MeshOption = Annotated[
    Path | None,
    Parameter(name="--mesh", help="The head's FLAME mesh, in place of flame_param.npz."),
]

INDEX = "frames.json"


def bake(
    avatar: AvatarInput,
    /,
    *,
    out: Out = None,
    frame: Frame = None,
    pose_from: PoseFrom = None,
    track: Annotated[
        bool, Parameter(negative="", help="Write every frame of the track, into a folder.")
    ] = False,
    landmarks_set: LandmarkSet = "254",
    landmarks_count: LandmarkCount = None,
    flame: FlameOption = None,
    mesh: MeshOption = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a rigged avatar (GaussianAvatars) as a plain splat in world space.

    Its landmarks are written beside it, where ``splatmorph fit`` finds them. With --track a
    folder of numbered files is written, which SuperSplat and Brush play as a sequence.
    """
    from splatmorph import io
    from splatmorph.app.exporting import lossy
    from splatmorph.avatars import load_avatar, thin, track_of
    from splatmorph.runs.export import write_measured

    if track and frame is not None:
        raise OptionError("--frame writes one frame and --track all of them: give one of the two")
    pose = None if track else pose_from
    loaded = load_avatar(
        avatar, frame=frame, pose=pose, landmarks_set=landmarks_set, flame=flame, mesh=mesh
    )
    if track:
        moved = loaded.rig.track if pose_from is None else track_of(pose_from)
        if moved is None:
            raise OptionError(f"{loaded.name} has no track: give one by --pose-from")
        _write_track(loaded, moved, out or Path(f"{loaded.name}-frames"), overwrite)
        return
    file = console.claim(out or Path(f"{loaded.name}.ply"), overwrite)
    beside = console.claim(file.with_name(f"{io.stem_of(file)}.landmarks.json"), overwrite)
    landmarks = loaded.landmarks
    if landmarks_count is not None:
        landmarks, _ = thin(landmarks, landmarks, landmarks_count)
    comment = f"splatmorph bake {loaded.name} {loaded.posed}"
    shift = write_measured(file, loaded.gaussians, [comment])
    landmarks.write(beside)
    console.say(
        f"wrote {file}: {len(loaded.gaussians):,} splats, posed {loaded.posed}{lossy(file, shift)}"
    )
    console.say(f"wrote {beside}: {len(landmarks)} landmarks")


def _write_track(avatar: Avatar, track: Track, folder: Path, overwrite: bool) -> None:
    from splatmorph import io
    from splatmorph.avatars import baked
    from splatmorph.io.atomic import make_folder, write_json

    console.claim(make_folder(folder) / INDEX, overwrite)
    rows = []
    with console.progress("baking") as update:
        for frame, gaussians in enumerate(baked(avatar.rig, track)):
            file = folder / f"frame_{frame:04d}.ply"
            io.write(file, gaussians, [f"splatmorph bake {avatar.name} frame={frame}"])
            rows.append({"file": file.name, "frame": frame, "splats": len(gaussians)})
            update(frame + 1, len(track), "")
    # Last, so that a folder with an index is whole.
    index = {"source": avatar.name, "track": str(track.path), "frames": rows}
    write_json(folder / INDEX, index)
    console.say(f"wrote {len(rows)} files, frame_0000.ply …, to {folder}")
