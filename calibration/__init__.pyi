from .blind import (
    calibrate_from_distances as calibrate_from_distances,
    calibrate_from_scene as calibrate_from_scene,
)
from .edges import (
    EdgeImage as EdgeImage,
    EdgeMeasurement as EdgeMeasurement,
    MeasuredTransfer as MeasuredTransfer,
    Region as Region,
    edges_of_image as edges_of_image,
)
from .errors import CalibrationError as CalibrationError
from .files import read_psf as read_psf, write_psf as write_psf
from .geometry import (
    CharucoBoard as CharucoBoard,
    GeometryCalibration as GeometryCalibration,
    geometry_of_captures as geometry_of_captures,
)
from .noise import NoiseCalibration as NoiseCalibration, noise_of_captures as noise_of_captures
from .psf import (
    Estimate as Estimate,
    PsfCalibration as PsfCalibration,
    psf_change as psf_change,
    psf_of_images as psf_of_images,
)
from .registration import (
    Registration as Registration,
    RegistrationHints as RegistrationHints,
    register_images as register_images,
)
