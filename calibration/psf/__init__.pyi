from ._calibration import (
    calibrate_mosaic as calibrate_mosaic,
    capture_images as capture_images,
    edge_images as edge_images,
    edge_records as edge_records,
    mosaic_plane as mosaic_plane,
    origin_of as origin_of,
    psf_of_images as psf_of_images,
    scene_records as scene_records,
)
from ._comparison import (
    PsfChange as PsfChange,
    focus_repeatability as focus_repeatability,
    focus_scatter_px2 as focus_scatter_px2,
    psf_change as psf_change,
    psf_steps as psf_steps,
)
from ._consistency import HeightGroup as HeightGroup, HeightTrend as HeightTrend
from ._control_chart import (
    FALSE_ALARMS as FALSE_ALARMS,
    ControlChart as ControlChart,
    Drift as Drift,
    control_charts as control_charts,
    cumulative_sums as cumulative_sums,
    cusum_limit as cusum_limit,
)
from ._covariance import (
    USUAL_RHO as USUAL_RHO,
    Estimate as Estimate,
    PsfEstimates as PsfEstimates,
    estimates_of_covariance as estimates_of_covariance,
    fit_covariance as fit_covariance,
    share_of_correlation as share_of_correlation,
)
from ._document import (
    CameraIdentity as CameraIdentity,
    ColourPsf as ColourPsf,
    PairWidths as PairWidths,
    PsfCalibration as PsfCalibration,
    PsfOrigin as PsfOrigin,
)
from ._field import FEWEST_FIELD_EDGES as FEWEST_FIELD_EDGES, FieldFit as FieldFit
from ._plot import (
    ORIENTATION_COLOURS as ORIENTATION_COLOURS,
    draw_mtf as draw_mtf,
    draw_transfer_2d as draw_transfer_2d,
    draw_widths_by_angle as draw_widths_by_angle,
)
from ._repeatability import capture_of as capture_of
from ._softness import measure_softness as measure_softness
from ._transfer_2d import (
    OtfTable as OtfTable,
    SampledLens as SampledLens,
    Transfer2d as Transfer2d,
    measure_transfer_2d as measure_transfer_2d,
)
