from .detection import find_edges as find_edges
from .segments import (
    BandPixels as BandPixels,
    EdgeLine as EdgeLine,
    EdgeSegment as EdgeSegment,
    band_half_width as band_half_width,
    band_pixels as band_pixels,
    side_level as side_level,
)

__all__ = [
    "BandPixels",
    "EdgeLine",
    "EdgeSegment",
    "band_half_width",
    "band_pixels",
    "find_edges",
    "side_level",
]
