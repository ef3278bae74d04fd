"""Correspondences that nobody picked: from two splats to landmarks on both."""

from splatmorph.registration.gaps import Gap, half_time_gap
from splatmorph.registration.search import (
    METHODS,
    Found,
    correspond,
    find_landmarks,
    refine_landmarks,
)

__all__ = [
    "METHODS",
    "Found",
    "Gap",
    "correspond",
    "find_landmarks",
    "half_time_gap",
    "refine_landmarks",
]
