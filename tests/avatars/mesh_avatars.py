"""An avatar whose mesh is a file, for the tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import synthetic_flame


def mesh_avatar(folder: Path, *, binding: Any = (0, 9975), **files: Any) -> Path:
    """An avatar on a mesh file: mesh_verts.npy and faces.npy, or what ``files`` has for them."""
    folder.mkdir(parents=True, exist_ok=True)
    synthetic_flame.write_local(folder / "point_cloud.ply", np.asarray(binding))
    model = synthetic_flame.model()
    for name, value in {"mesh_verts": model["v_template"], "faces": model["f"], **files}.items():
        if value is not None:
            np.save(folder / f"{name}.npy", value)
    return folder
