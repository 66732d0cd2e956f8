from .followups import simulate_pose as simulate_pose, zoom_out as zoom_out
from .psfs import (
    calibrate_psf as calibrate_psf,
    measure_edges as measure_edges,
    read_psf as read_psf,
    write_psf as write_psf,
)

__all__ = [
    "calibrate_psf",
    "measure_edges",
    "read_psf",
    "simulate_pose",
    "write_psf",
    "zoom_out",
]
