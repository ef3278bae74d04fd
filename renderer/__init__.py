"""Pixels from Gaussian splats: cameras, a rasterizer for CPU and CUDA, pictures and videos.

    from renderer import bounds_of, orbit, rasterize, write_image

    camera = orbit(bounds_of(means, opacities, scales), [30.0])[0]
    rgb, alpha, depth = rasterize(
        means, quats, scales, opacities, sh, camera.viewmat, camera.K, 512, 512
    )
    write_image("splat.png", rgb, alpha)

Arrays are numpy or torch. See ``docs/conventions.md`` for axes, units and choices.
"""

from renderer.camera_files import read_cameras
from renderer.cameras import (
    Bounds,
    Camera,
    bounds_of,
    camera_path,
    look_at,
    orbit,
)
from renderer.errors import ArgumentError, CameraFileError, OutputError, RenderError
from renderer.rasterize import gather, rasterize
from renderer.reference import rasterize_reference
from renderer.video import check_output, to_bytes, write_image, write_video

__all__ = [
    "ArgumentError",
    "Bounds",
    "Camera",
    "CameraFileError",
    "OutputError",
    "RenderError",
    "bounds_of",
    "camera_path",
    "check_output",
    "gather",
    "look_at",
    "orbit",
    "rasterize",
    "rasterize_reference",
    "read_cameras",
    "to_bytes",
    "write_image",
    "write_video",
]
