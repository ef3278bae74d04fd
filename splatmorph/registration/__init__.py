"""Correspondences that nobody picked: from two splats to landmarks on both."""

from splatmorph.registration.search import (
    METHODS,
    Found,
    correspond,
    find_landmarks,
    refine_landmarks,
)

__all__ = ["METHODS", "Found", "correspond", "find_landmarks", "refine_landmarks"]
