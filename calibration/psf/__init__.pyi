from .calibration import (
    CalibrationMethod as CalibrationMethod,
    PairWidths as PairWidths,
    PsfCalibration as PsfCalibration,
    calibrate_mosaic as calibrate_mosaic,
    calibrate_psf as calibrate_psf,
)
from .captures import (
    capture_images as capture_images,
    edge_images as edge_images,
    edge_records as edge_records,
    scene_records as scene_records,
)
from .comparison import compare_psfs as compare_psfs
from .covariance import (
    Estimate as Estimate,
    fit_covariance as fit_covariance,
    share_of_correlation as share_of_correlation,
)
from .document import (
    PSF_SCHEMA as PSF_SCHEMA,
    PsfOrigin as PsfOrigin,
    StoredCamera as StoredCamera,
    StoredCurve as StoredCurve,
    StoredEdge as StoredEdge,
    StoredField as StoredField,
    StoredHeight as StoredHeight,
    StoredHeightTrend as StoredHeightTrend,
    StoredPsf as StoredPsf,
    StoredTransfer as StoredTransfer,
    edge_document as edge_document,
    psf_document as psf_document,
)
from .linearise import (
    Channel as Channel,
    luma_plane as luma_plane,
    srgb_to_linear as srgb_to_linear,
)

__all__ = [
    "PSF_SCHEMA",
    "CalibrationMethod",
    "Channel",
    "Estimate",
    "PairWidths",
    "PsfCalibration",
    "PsfOrigin",
    "StoredCamera",
    "StoredCurve",
    "StoredEdge",
    "StoredField",
    "StoredHeight",
    "StoredHeightTrend",
    "StoredPsf",
    "StoredTransfer",
    "calibrate_mosaic",
    "calibrate_psf",
    "capture_images",
    "compare_psfs",
    "edge_document",
    "edge_images",
    "edge_records",
    "fit_covariance",
    "luma_plane",
    "psf_document",
    "scene_records",
    "share_of_correlation",
    "srgb_to_linear",
]
