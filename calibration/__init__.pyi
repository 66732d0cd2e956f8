from .blind import (
    calibrate_from_distances as calibrate_from_distances,
    calibrate_from_scene as calibrate_from_scene,
)
from .edges import (
    EdgeImage as EdgeImage,
    EdgeMeasurement as EdgeMeasurement,
    MeasuredTransfer as MeasuredTransfer,
    Region as Region,
    measure_edges as measure_edges,
)
from .errors import CalibrationError as CalibrationError
from .files import read_psf as read_psf, write_psf as write_psf
from .geometry import (
    CharucoBoard as CharucoBoard,
    GeometryCalibration as GeometryCalibration,
    calibrate_geometry as calibrate_geometry,
)
from .noise import NoiseCalibration as NoiseCalibration, measure_noise as measure_noise
from .psf import (
    Estimate as Estimate,
    PsfCalibration as PsfCalibration,
    calibrate_psf as calibrate_psf,
    compare_psfs as compare_psfs,
)
from .registration import (
    Registration as Registration,
    RegistrationHints as RegistrationHints,
    register as register,
)
