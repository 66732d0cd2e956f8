from .axis_transfer import (
    AxisTransfer as AxisTransfer,
    MeasuredTransfer as MeasuredTransfer,
    mean_transfer as mean_transfer,
)
from .binned import (
    BinnedEdge as BinnedEdge,
    bin_centres_px as bin_centres_px,
    bin_edge as bin_edge,
)
from .esfr import (
    SFR_FREQ_CY_PER_PX as SFR_FREQ_CY_PER_PX,
    EdgeSfr as EdgeSfr,
    esfr_half_width_px as esfr_half_width_px,
    measure_esfr as measure_esfr,
)
from .gaussian_mtf import gaussian_mtf50 as gaussian_mtf50, pixel_mtf50 as pixel_mtf50
from .image import EdgeImage as EdgeImage, Region as Region
from .measurement import (
    REJECTING_FLAGS as REJECTING_FLAGS,
    EdgeMeasurement as EdgeMeasurement,
    Method as Method,
    measure_edges as measure_edges,
)
from .mosaic import PITCH_PX as PITCH_PX, PlanePlace as PlanePlace, plane_places as plane_places
from .orientation import Orientation as Orientation, orientation_of as orientation_of
from .samples import (
    EdgeSamples as EdgeSamples,
    edge_samples as edge_samples,
    roughness_px as roughness_px,
    without_shading as without_shading,
)
from .selection import EdgeSelection as EdgeSelection, told_apart as told_apart
from .straightness import border_flags as border_flags
