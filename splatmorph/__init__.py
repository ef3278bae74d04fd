"""splatmorph: morph one 3D Gaussian splat into another, by flows."""

from splatmorph._version import __version__
from splatmorph.errors import SplatmorphError
from splatmorph.gaussians import Gaussians

__all__ = ["Gaussians", "SplatmorphError", "__version__"]
