from .bench import Bench as Bench, height_series as height_series
from .comparison import find_changes as find_changes, register as register
from .detection import (
    DetectionTask as DetectionTask,
    d_prime_curves as d_prime_curves,
    pose_limits as pose_limits,
)
from .followups import simulate_pose as simulate_pose, zoom_out as zoom_out
from .inputs import FilePath as FilePath, path_of as path_of
from .photographs import read_image as read_image
from .psfs import (
    calibrate_psf as calibrate_psf,
    measure_edges as measure_edges,
    read_psf as read_psf,
    write_psf as write_psf,
)

__all__ = [
    "Bench",
    "DetectionTask",
    "FilePath",
    "calibrate_psf",
    "d_prime_curves",
    "find_changes",
    "height_series",
    "measure_edges",
    "path_of",
    "pose_limits",
    "read_image",
    "read_psf",
    "register",
    "simulate_pose",
    "write_psf",
    "zoom_out",
]
