"""USD with ParticleField3DGaussianSplat: splats that may change with time, in one file.

Scales and opacities are stored activated, harmonics splat by splat. What changes has a sample for
each time, between which players interpolate; what doesn't is stored once.
https://openusd.org/release/user_guides/schemas/usdVol/ParticleField3DGaussianSplat.html
"""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from splatmorph._version import __version__
from splatmorph.errors import MissingExtraError, ReadError, WriteError
from splatmorph.gaussians import Gaussians
from splatmorph.io.atomic import atomic_write
from splatmorph.io.gltf import placed
from splatmorph.io.offsets import about
from splatmorph.io.packed import FAINTEST, stored_arrays, unpacked
from splatmorph.io.reading import require_file
from splatmorph.timeline import STILL, Timeline

UPS = {"y": "Y", "z": "Z"}
"""The axes that USD knows as up, and its names for them."""
PRIM, KIND = "/splats", "ParticleField3DGaussianSplat"
HIGHEST_DEGREE = 3
EXTENT_SIGMAS = 3.0
ARCHIVE = ".usdz"
MEMORY, MEMORY_GAIN = 3 << 30, 10
"""Bytes of addresses that reading may take, and times the size of the file that it may besides."""
NAMES = ("positions", "orientations", "scales", "opacities")
LONGEST = 600
"""Seconds that reading may take."""
HARMONICS, DEGREE = "radiance:sphericalHarmonicsCoefficients", "radiance:sphericalHarmonicsDegree"


@dataclass
class _Attribute:
    """An attribute that gets time samples once it changes."""

    handle: Any
    kept: Any = None
    codes: list[float] = field(default_factory=list)
    changed: bool = False

    def put(self, values: NDArray[Any], usd: Any, code: float) -> None:
        """The value at a time code; times come in ascending order."""
        if self.kept is None:
            self.handle.Set(usd)
        elif not self.changed and not np.array_equal(values, self.kept[0]):
            self.changed = True
            for earlier in {self.codes[0], self.codes[-1]}:
                self.handle.Set(self.kept[1], earlier)
        if self.changed:
            self.handle.Set(usd, code)
        self.kept = values, usd
        self.codes.append(code)


def read_usd(path: str | Path, *, time: float | None = None) -> Gaussians:
    """Read every Gaussian splat of a USD stage, in world space, at one moment.

    Args:
        path: ``.usd``, ``.usda``, ``.usdc`` or ``.usdz``.
        time: a time code; the first sample by default.

    Raises:
        MissingExtraError: usd-core is not installed.
        ReadError: see :func:`splatmorph.io.read`; or a stage without splats.
    """
    path = Path(path)
    found = _moment(path, time)
    count = sum(name.endswith("/matrix") for name in found)
    if not count:
        raise ReadError(f"{path} holds no {KIND}, only other prims: convert it to Gaussians first")
    parts = [placed(_splats_of(found, i, path), found[f"{i}/matrix"], path) for i in range(count)]
    whole = parts[0]
    for part in parts[1:]:
        whole = Gaussians.union(whole, about(part, whole.offset))
    return replace(whole, up=str(found["up"]))


def usd_layout(path: str | Path) -> str:
    """In words, what a USD stage says of its splats' time.

    Raises:
        ReadError: see :func:`read_usd`.
    """
    start, end, rate = _moment(Path(path), None)["range"].tolist()
    if not end > start:
        return f"USD with {KIND}"
    return f"USD with {KIND}, an animation of {(end - start) / rate:g} s; its first moment is read"


def write_usd(path: str | Path, gaussians: Gaussians, comments: Sequence[str] = ()) -> None:
    """Write a splat that stands still; the extension says text, binary or archive.

    Raises:
        MissingExtraError: usd-core is not installed.
        WriteError: see :func:`splatmorph.io.write`.
    """
    degree = min(gaussians.sh_degree, HIGHEST_DEGREE)
    write_animation(path, [gaussians], degree=degree, comments=comments)


def write_animation(
    path: str | Path,
    frames: Iterable[Gaussians],
    *,
    count: int = 1,
    timeline: Timeline = STILL,
    degree: int = HIGHEST_DEGREE,
    comments: Sequence[str] = (),
) -> None:
    """Write splats that change with time, whole or not at all, one frame in memory at a time.

    Args:
        path: ``.usda``, ``.usdc``, ``.usd`` or ``.usdz``.
        frames: the splats at evenly spaced times; players interpolate where one frame has as many
            as the next.
        count: of the frames.
        timeline: how long they play.
        degree: of the harmonics, the same throughout.
        comments: for the stage.

    Raises:
        MissingExtraError: usd-core is not installed.
        WriteError: see :func:`splatmorph.io.write`.
    """
    path = Path(path)
    _require()
    codes = timeline.codes(count)
    with atomic_write(path) as partial, tempfile.TemporaryDirectory(dir=path.parent) as folder:
        if path.suffix.lower() != ARCHIVE:
            _write_stage(partial, frames, codes, timeline, degree, comments)
            return
        from pxr import Sdf, UsdUtils

        inside = Path(folder) / f"{path.stem}.usdc"
        _write_stage(inside, frames, codes, timeline, degree, comments)
        if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(inside)), str(partial)):
            raise WriteError(f"can't pack {path}: is there room on the disk?")


# Reading ------------------------------------------------------------------------------------


def _require() -> None:
    try:
        import pxr  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("usd-core", "usd", "USD") from error


def _moment(path: Path, time: float | None) -> dict[str, NDArray[Any]]:
    """What ``usd_moment`` finds in a process of its own."""
    _require()
    require_file(path)
    limit = MEMORY + MEMORY_GAIN * path.stat().st_size
    program = Path(__file__).with_name("usd_moment.py")
    moment = "" if time is None else str(time)
    command = [sys.executable, str(program), str(path), moment, str(limit)]
    ran = subprocess.run(command, capture_output=True, check=False, timeout=LONGEST)
    if ran.returncode:
        raise ReadError(
            f"{path} is no whole USD file: it is truncated or another format; export it again"
        )
    with np.load(io.BytesIO(ran.stdout), allow_pickle=False) as stored:
        return dict(stored)


def _splats_of(found: Mapping[str, NDArray[Any]], i: int, path: Path) -> Gaussians:
    lacking = [name for name in (*NAMES, HARMONICS) if f"{i}/{name}" not in found]
    if lacking:
        raise ReadError(f"{path} has splats without {lacking[0]}: export it again")
    means, quats, scales, opacities = (found[f"{i}/{name}"] for name in NAMES)
    each = (int(found[f"{i}/{DEGREE}"]) + 1) ** 2
    tiny = np.finfo(np.float32).tiny
    parts = {
        "means": means,
        # As quaternions lie in memory, the real part is the last.
        "quats": np.roll(quats, 1, axis=1),
        "log_scales": np.log(np.maximum(scales.astype(np.float64), tiny)),
        "opacities": opacities[:, 0],
        "sh": found[f"{i}/{HARMONICS}"][: each * len(means)].reshape(-1, each, 3),
    }
    if any(len(part) != len(means) for part in parts.values()):
        raise ValueError("its attributes differ in their number of splats")
    return unpacked(path, **parts)


# Writing ------------------------------------------------------------------------------------


def _write_stage(
    path: Path,
    frames: Iterable[Gaussians],
    codes: Sequence[float],
    timeline: Timeline,
    degree: int,
    comments: Sequence[str],
) -> None:
    from pxr import Gf, Usd, UsdGeom, UsdVol, Vt

    stage = Usd.Stage.CreateNew(str(path))
    splats = UsdVol.ParticleField3DGaussianSplat.Define(stage, PRIM)
    prim = splats.GetPrim()
    stage.SetDefaultPrim(prim)
    UsdGeom.SetStageMetersPerUnit(stage, timeline.metres_per_unit)
    stage.GetRootLayer().comment = "\n".join([f"Generated by splatmorph {__version__}", *comments])
    if len(codes) > 1:
        stage.SetStartTimeCode(codes[0])
        stage.SetEndTimeCode(codes[-1])
        stage.SetTimeCodesPerSecond(timeline.fps)
        stage.SetFramesPerSecond(timeline.fps)
    prim.GetAttribute(DEGREE).Set(degree)
    prim.GetAttribute("sortingModeHint").Set("cameraDistance")
    attributes = {
        name: _Attribute(prim.GetAttribute(name)) for name in (*NAMES, HARMONICS, "extent")
    }
    shift = _Attribute(splats.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).GetAttr())
    text = path.suffix.lower() == ".usda"
    before = None
    for code, frame in zip(codes, frames, strict=True):
        UsdGeom.SetStageUpAxis(stage, UPS[frame.up or "y"])
        arrays = _arrays(frame.with_sh_degree(degree), path)
        quats = arrays["orientations"]
        if before is not None and len(before) == len(quats):
            # q and -q are one rotation, but what lies between them is not.
            quats[(quats * before).sum(axis=1) < 0] *= -1
        before = quats.copy()
        for name, values in arrays.items():
            kind = Vt.QuatfArray if name == "orientations" else Vt.Vec3fArray
            kind = Vt.FloatArray if name == "opacities" else kind
            # Imaginary parts come first in memory, as numpy fills it.
            stored = np.roll(values, -1, axis=1) if name == "orientations" else values
            attributes[name].put(values, kind.FromNumpy(np.ascontiguousarray(stored)), code)
        shift.put(np.array(frame.offset), Gf.Vec3d(*frame.offset), code)
        if not text:
            # What is saved needn't stay in memory; text would be written anew each time.
            stage.Save()
    if not any(shift.kept[0]) and not shift.changed:
        prim.RemoveProperty(shift.handle.GetName())
        prim.RemoveProperty("xformOpOrder")
    stage.Save()


def _arrays(gaussians: Gaussians, path: Path) -> dict[str, NDArray[np.float32]]:
    """The values of the schema's attributes at one moment; quaternions wxyz."""
    _, quats, log_scales, sh = stored_arrays(gaussians, path)
    means = gaussians.means.detach().cpu().numpy()
    scales = np.exp(log_scales).clip(np.finfo(np.float32).tiny, np.finfo(np.float32).max)
    reach = EXTENT_SIGMAS * scales.max(axis=1, keepdims=True)
    alphas = torch.sigmoid(gaussians.opacity_logits.detach().cpu().double()).numpy()
    values = {
        "positions": means,
        "orientations": quats,
        "scales": scales,
        "opacities": alphas.clip(FAINTEST, 1 - FAINTEST),
        HARMONICS: sh.reshape(-1, 3),
        "extent": np.stack([(means - reach).min(axis=0), (means + reach).max(axis=0)]),
    }
    return {name: np.ascontiguousarray(array, np.float32) for name, array in values.items()}
