from .library.bench import Bench as Bench
from .library.comparison import (
    FeatureMatches as FeatureMatches,
    RegistrationHints as RegistrationHints,
    find_changes as find_changes,
    register as register,
)
from .library.detection import (
    DetectionTask as DetectionTask,
    d_prime_curves as d_prime_curves,
    pose_limits as pose_limits,
)
from .library.followups import simulate_pose as simulate_pose, zoom_out as zoom_out
from .library.photographs import read_image as read_image
from .library.psfs import (
    GaussianPsf as GaussianPsf,
    Session as Session,
    calibrate_psf as calibrate_psf,
    measure_edges as measure_edges,
    read_psf as read_psf,
    write_psf as write_psf,
)

__all__ = [
    "Bench",
    "DetectionTask",
    "FeatureMatches",
    "GaussianPsf",
    "RegistrationHints",
    "Session",
    "calibrate_psf",
    "d_prime_curves",
    "find_changes",
    "measure_edges",
    "pose_limits",
    "read_image",
    "read_psf",
    "register",
    "simulate_pose",
    "write_psf",
    "zoom_out",
]

__version__: str
