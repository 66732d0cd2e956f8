from .binned import (
    BinnedEdge as BinnedEdge,
    bin_centres_px as bin_centres_px,
    bin_edge as bin_edge,
)
from .detection import find_edges as find_edges
from .esfr import (
    SFR_FREQ_CY_PER_PX as SFR_FREQ_CY_PER_PX,
    AxisTransfer as AxisTransfer,
    MeasuredTransfer as MeasuredTransfer,
    esfr_half_width_px as esfr_half_width_px,
    gaussian_mtf50 as gaussian_mtf50,
    mean_transfer as mean_transfer,
    measure_esfr as measure_esfr,
    pixel_mtf50 as pixel_mtf50,
)
from .fit import EdgeFit as EdgeFit, fit_edge as fit_edge
from .jpeg import JpegCompression as JpegCompression
from .measurement import (
    REJECTING_FLAGS as REJECTING_FLAGS,
    EdgeImage as EdgeImage,
    EdgeMeasurement as EdgeMeasurement,
    Method as Method,
    Region as Region,
    measure_edges as measure_edges,
)
from .model import edge_profile as edge_profile
from .mosaic import PITCH_PX as PITCH_PX, PlanePlace as PlanePlace, plane_places as plane_places
from .orientation import Orientation as Orientation, orientation_of as orientation_of
from .samples import EdgeSamples as EdgeSamples, edge_samples as edge_samples
from .segments import (
    EdgeSegment as EdgeSegment,
    band_half_width as band_half_width,
    band_pixels as band_pixels,
    side_level as side_level,
)

__all__ = [
    "PITCH_PX",
    "REJECTING_FLAGS",
    "SFR_FREQ_CY_PER_PX",
    "AxisTransfer",
    "BinnedEdge",
    "EdgeFit",
    "EdgeImage",
    "EdgeMeasurement",
    "EdgeSamples",
    "EdgeSegment",
    "JpegCompression",
    "MeasuredTransfer",
    "Method",
    "Orientation",
    "PlanePlace",
    "Region",
    "band_half_width",
    "band_pixels",
    "bin_centres_px",
    "bin_edge",
    "edge_profile",
    "edge_samples",
    "esfr_half_width_px",
    "find_edges",
    "fit_edge",
    "gaussian_mtf50",
    "mean_transfer",
    "measure_edges",
    "measure_esfr",
    "orientation_of",
    "pixel_mtf50",
    "plane_places",
    "side_level",
]
