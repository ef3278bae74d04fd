"""Images: the plane as the degenerate case. Only this package knows pixels."""

from splatmorph.images.blend import Blend, linear, poisson
from splatmorph.images.canvas import Canvas
from splatmorph.images.morph import ImageMorph
from splatmorph.images.picture import Picture
from splatmorph.images.points import CONVENTIONS, read_pair, read_points, with_anchors
from splatmorph.images.warp import EDGES, INTERPOLATIONS, FlowWarp, Warp

__all__ = [
    "CONVENTIONS",
    "EDGES",
    "INTERPOLATIONS",
    "Blend",
    "Canvas",
    "FlowWarp",
    "ImageMorph",
    "Picture",
    "Warp",
    "linear",
    "poisson",
    "read_pair",
    "read_points",
    "with_anchors",
]
