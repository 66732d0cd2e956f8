from ._calibration import (
    SCENE_ERR as SCENE_ERR,
    calibrate_from_distances as calibrate_from_distances,
    calibrate_from_scene as calibrate_from_scene,
    is_clear as is_clear,
)
from .two_distance import NearAndFar as NearAndFar, pair_psf as pair_psf
