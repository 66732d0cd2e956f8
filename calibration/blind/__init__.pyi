from .calibration import (
    CLEAREST_SNR as CLEAREST_SNR,
    calibrate_from_distances as calibrate_from_distances,
    calibrate_from_scene as calibrate_from_scene,
)
from .two_distance import pair_psf as pair_psf

__all__ = [
    "CLEAREST_SNR",
    "calibrate_from_distances",
    "calibrate_from_scene",
    "pair_psf",
]
