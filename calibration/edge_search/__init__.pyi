from .detection import find_edges as find_edges
from .gradient import SMOOTHING_PX as SMOOTHING_PX
from .ridges import ArtefactGradient as ArtefactGradient
from .segments import (
    SHORTEST_PX as SHORTEST_PX,
    BandPixels as BandPixels,
    EdgeLine as EdgeLine,
    EdgeSegment as EdgeSegment,
    band_half_width as band_half_width,
    band_pixels as band_pixels,
    least_side_px as least_side_px,
    side_level as side_level,
)
from .target import beside_target as beside_target
