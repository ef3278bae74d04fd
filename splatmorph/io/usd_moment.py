"""A USD stage's splats at one moment, as arrays: a program of its own, run as a file.

A damaged stage makes USD's library take all the memory there is, or crash. So it is read apart,
with a limit, and by what imports nothing else.
"""

import io
import sys

import numpy as np
from pxr import Usd, UsdGeom

KIND = "ParticleField3DGaussianSplat"
ATTRIBUTES = {
    "positions": 3,
    "orientations": 4,
    "scales": 3,
    "opacities": 1,
    "radiance:sphericalHarmonicsCoefficients": 3,
}
"""Numbers in an element of each. A name with an h has halfs, which are second to floats."""
DEGREE = "radiance:sphericalHarmonicsDegree"


def limit_memory(size: int) -> None:
    """Let the process have no more than ``size`` bytes of addresses, where that can be asked."""
    try:
        import resource
    except ImportError:  # Windows
        return
    resource.setrlimit(resource.RLIMIT_AS, (size, size))


def moment(path: str, time: float | None) -> dict[str, np.ndarray]:
    """Arrays of all splats: ``<i>/<attribute>`` and ``<i>/matrix`` (local → world) of each prim.

    ``up`` is the stage's axis; ``range`` its first and last time code, and how many a second.
    """
    stage = Usd.Stage.Open(path)
    when = Usd.TimeCode.EarliestTime() if time is None else Usd.TimeCode(time)
    places = UsdGeom.XformCache(when)
    codes = (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond())
    found = {"up": np.array(str(UsdGeom.GetStageUpAxis(stage)).lower()), "range": np.array(codes)}
    prims = (prim for prim in stage.Traverse() if prim.GetTypeName() == KIND)
    for i, prim in enumerate(prims):
        matrix = places.GetLocalToWorldTransform(prim)
        found[f"{i}/matrix"] = np.array(matrix, float).T
        found[f"{i}/{DEGREE}"] = np.array(prim.GetAttribute(DEGREE).Get())
        for name, width in ATTRIBUTES.items():
            values = (prim.GetAttribute(name + kind).Get(when) for kind in ("", "h"))
            stored = next((one for one in values if one is not None), None)
            if stored is not None:
                found[f"{i}/{name}"] = np.asarray(stored, np.float32).reshape(-1, width)
    return found


if __name__ == "__main__":
    limit_memory(int(sys.argv[3]))
    archive = io.BytesIO()
    arrays = moment(sys.argv[1], float(sys.argv[2]) if sys.argv[2] else None)
    np.savez(archive, allow_pickle=False, **arrays)
    sys.stdout.buffer.write(archive.getbuffer())
