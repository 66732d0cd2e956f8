from ._detection import find_edges as find_edges
from ._esfr import (
    SFR_FREQ_CY_PER_PX as SFR_FREQ_CY_PER_PX,
    EdgeSfr as EdgeSfr,
    esfr_half_width_px as esfr_half_width_px,
    gaussian_mtf50 as gaussian_mtf50,
    measure_esfr as measure_esfr,
    pixel_mtf50 as pixel_mtf50,
)
from ._fit import EdgeFit as EdgeFit, JpegCompression as JpegCompression, fit_edge as fit_edge
from ._image import (
    PITCH_PX as PITCH_PX,
    EdgeImage as EdgeImage,
    PlanePlace as PlanePlace,
    Region as Region,
    plane_places as plane_places,
)
from ._model import edge_profile as edge_profile
from ._rounded import NEARLY_SATURATED as NEARLY_SATURATED
from ._samples import (
    BinnedEdge as BinnedEdge,
    EdgeSamples as EdgeSamples,
    bin_centres_px as bin_centres_px,
    bin_edge as bin_edge,
    border_flags as border_flags,
    edge_samples as edge_samples,
    roughness_px as roughness_px,
    without_shading as without_shading,
)
from ._segments import (
    EdgeLine as EdgeLine,
    EdgeSegment as EdgeSegment,
    Orientation as Orientation,
    band_half_width as band_half_width,
    band_pixels as band_pixels,
    least_side_px as least_side_px,
    orientation_of as orientation_of,
    side_level as side_level,
)
from .measurement import (
    REJECTING_FLAGS as REJECTING_FLAGS,
    AxisTransfer as AxisTransfer,
    EdgeMeasurement as EdgeMeasurement,
    EdgeSelection as EdgeSelection,
    MeasuredTransfer as MeasuredTransfer,
    Method as Method,
    edges_of_image as edges_of_image,
    mean_transfer as mean_transfer,
)
