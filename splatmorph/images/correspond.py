"""Correspondences found in the pictures themselves; needs OpenCV (the extra ``images``)."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import torch
from PIL import Image
from scipy.spatial import cKDTree

from splatmorph.errors import LandmarkError, MissingExtraError
from splatmorph.images.canvas import Canvas
from splatmorph.images.picture import Picture
from splatmorph.landmarks import Landmarks

Points = np.ndarray[Any, np.dtype[np.float64]]

LONGEST = 1600
"""Pictures are reduced to this many pixels before features are sought in them."""

RATIO = 0.8
"""A match must be this much closer than the second best (Lowe 2004, section 7.1)."""

OFF_PLANE = 0.02
"""How far a match may be from the homography that most agree on, in longer sides."""

MOST = 300
"""Correspondences kept, the farthest apart: a flow gains nothing from two a pixel apart."""

FEWEST = 8
RETURN = 0.5
"""Forward and backward optical flow must meet again within this many pixels."""

FLAT = 1e-5
"""Where a patch's gradients are weaker than this (eigenvalue, grey in [0, 1]), flow is a guess."""


def match_features(source: Picture, target: Picture) -> tuple[Landmarks, Landmarks]:
    """Points that look alike: SIFT, ratio test both ways, RANSAC on a homography.

    For two pictures of one thing. Different faces have next to nothing in common for it.

    Raises:
        MissingExtraError: OpenCV is not installed.
        LandmarkError: fewer than ``FEWEST`` correspondences.
    """
    cv2 = _opencv("finding correspondences")
    (p, near), (q, far) = (_features(cv2, picture) for picture in (source, target))
    pairs = np.empty((0, 2), int)
    if min(len(p), len(q)) > 1:
        pairs = np.array(sorted(_good(cv2, near, far) & {(i, j) for j, i in _good(cv2, far, near)}))
    if len(pairs) >= FEWEST:
        p, q = p[pairs[:, 0]], q[pairs[:, 1]]
        cv2.setRNGSeed(0)
        _, agree = cv2.findHomography(p, q, cv2.USAC_MAGSAC, 2 * OFF_PLANE, maxIters=10_000)
        kept = np.zeros(len(p), bool) if agree is None else agree.ravel().astype(bool)
        p, q = p[kept], q[kept]
    return _landmarks(p, q, "features that both pictures show", pairs)


def follow_motion(source: Picture, target: Picture) -> tuple[Landmarks, Landmarks]:
    """Points of one frame of a video found in a later one: a sparse sample of the optical flow.

    Dense inverse search (OpenCV's DIS), on a grid, where the patch has texture and the flow
    back returns to where it began.

    Raises:
        MissingExtraError: OpenCV is not installed.
        LandmarkError: the frames differ in size, or fewer than ``FEWEST`` points can be followed.
    """
    cv2 = _opencv("optical flow")
    if source.canvas != target.canvas:
        sizes = " and ".join(f"{c.width}x{c.height}" for c in (source.canvas, target.canvas))
        raise LandmarkError(f"the frames are {sizes}: optical flow needs two of one size")
    forward, backward = dense_motion(source, target), dense_motion(target, source)
    canvas = source.canvas
    step = max(4, round(np.sqrt(canvas.width * canvas.height / MOST)))
    x, y = (a.ravel() for a in np.mgrid[step // 2 : canvas.width : step,
                                        step // 2 : canvas.height : step])  # fmt: skip
    moved = forward[y, x]
    end = np.stack([x, y], 1) + moved
    column, row = np.rint(end).astype(int).T
    inside = (column >= 0) & (column < canvas.width) & (row >= 0) & (row < canvas.height)
    back = np.full_like(moved, np.inf)
    back[inside] = backward[row[inside], column[inside]]
    texture = cv2.cornerMinEigenVal(_grey(source).astype(np.float32) / 255, 7)
    kept = (np.linalg.norm(moved + back, axis=1) < RETURN) & (texture[y, x] > FLAT)
    start = np.stack([x, y], 1)[kept] + 0.5
    p, q = (canvas.to_world(torch.from_numpy(a)).numpy() for a in (start, start + moved[kept]))
    return _landmarks(p, q, "points that can be followed", start)


def dense_motion(source: Picture, target: Picture) -> Points:
    """Where each pixel of ``source`` goes in ``target``: (height, width, 2) pixels, y down."""
    cv2 = _opencv("optical flow")
    search = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    return search.calc(_grey(source), _grey(target), None).astype(np.float64)


def _opencv(purpose: str) -> ModuleType:
    try:
        import cv2
    except ImportError as error:
        raise MissingExtraError("opencv-python-headless", "images", purpose) from error
    return cv2


def _grey(picture: Picture) -> np.ndarray:
    rgb = picture.with_channels(3) if picture.channels == 4 else picture
    pixels = rgb.eight_bit()
    mode = "L" if picture.channels == 1 else "RGB"
    return np.array(Image.fromarray(pixels.squeeze(2) if mode == "L" else pixels).convert("L"))


def _features(cv2: ModuleType, picture: Picture) -> tuple[Points, np.ndarray]:
    grey = _grey(picture)
    factor = min(1.0, LONGEST / max(grey.shape))
    if factor < 1:
        grey = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    found, descriptors = cv2.SIFT_create().detectAndCompute(grey, None)
    pixels = np.array([point.pt for point in found]).reshape(-1, 2) + 0.5
    seen = Canvas(grey.shape[1], grey.shape[0])
    return seen.to_world(torch.from_numpy(pixels)).numpy(), descriptors


def _good(cv2: ModuleType, near: np.ndarray, far: np.ndarray) -> set[tuple[int, int]]:
    pairs = cv2.BFMatcher().knnMatch(near, far, k=2)
    return {(a.queryIdx, a.trainIdx) for a, b in pairs if a.distance < RATIO * b.distance}


def _landmarks(p: Points, q: Points, what: str, found: np.ndarray) -> tuple[Landmarks, Landmarks]:
    if len(found) < FEWEST or len(p) < FEWEST:
        raise LandmarkError(
            f"found {min(len(found), len(p))} {what}, expected at least {FEWEST}: give landmarks"
        )
    kept = _spread(np.concatenate([p, q], axis=1))
    return Landmarks(torch.from_numpy(p[kept])), Landmarks(torch.from_numpy(q[kept]))


def _spread(points: np.ndarray) -> list[int]:
    """Indices of at most ``MOST`` points that keep away from each other, in order."""
    radius = np.ptp(points, axis=0).max() / (2 * np.sqrt(MOST))
    taken = np.ones(len(points), bool)
    for i, near in enumerate(cKDTree(points).query_ball_point(points, radius)):
        if taken[i]:
            taken[[j for j in near if j > i]] = False
    return np.flatnonzero(taken)[:MOST].tolist()
