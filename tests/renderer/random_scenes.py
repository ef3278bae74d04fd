"""Scenes and comparisons of the renderer's tests."""

from __future__ import annotations

from typing import Any

import numpy as np

Scene = dict[str, np.ndarray]


def random_scene(n: int, degree: int, seed: int, spread: float = 1.0) -> Scene:
    """n splats about the origin, from dust to slabs and needles."""
    rng = np.random.default_rng(seed)
    return {
        "means": (spread * rng.normal(size=(n, 3))).astype(np.float32),
        "quats": rng.normal(size=(n, 4)).astype(np.float32),
        "scales": np.exp(rng.normal(-2.5, 1.0, (n, 3))).astype(np.float32),
        "opacities": rng.uniform(0, 1, n).astype(np.float32),
        "sh": rng.normal(0, 0.5, (n, (degree + 1) ** 2, 3)).astype(np.float32),
    }


def pinhole(width: int, height: int, distance: float = 4.0) -> dict[str, Any]:
    """A camera on -z that looks at the origin, of about 50 degrees."""
    viewmat = np.eye(4)
    viewmat[2, 3] = distance
    focal = 1.1 * max(width, height)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return {"viewmat": viewmat, "K": K, "width": width, "height": height}


def assert_same_picture(found: tuple[Any, ...], expected: tuple[Any, ...]) -> None:
    """Equal but for float rounding and for threshold flips, which are rare and bounded.

    A pixel flips where float32 falls on the other side of the skip (1/255) or of the stop
    (1e-4): at most 0.01, on at most 0.1 % of the pixels (and on one, in small pictures).
    """
    for name, a, b in zip(("rgb", "alpha"), found, expected, strict=False):
        assert np.isfinite(a).all(), name
        error = np.abs(a - b).reshape(*b.shape[:2], -1).max(-1)
        assert error.max() <= 0.01, f"{name}: max {error.max():.4f}"
        assert (error > 1e-3).sum() <= max(1, 1e-3 * error.size), f"{name}: {error}"
    # Depth is a mean: where little is seen, a flip may move it anywhere.
    depth, wanted, seen = found[2], expected[2], expected[1] > 0.1
    error = np.abs(depth - wanted)[seen] / np.maximum(wanted[seen], 1)
    assert (error > 1e-2).sum() <= max(1, 1e-3 * error.size)
