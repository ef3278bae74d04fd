"""The morph: what lies between two splats that a flow connects."""

from splatmorph.morph.chain import Chain, average, mean_landmarks
from splatmorph.morph.morph import Morph

__all__ = ["Chain", "Morph", "average", "mean_landmarks"]
