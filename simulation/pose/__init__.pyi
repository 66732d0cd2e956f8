from .homography import (
    project as project,
    projection_depth as projection_depth,
    projection_slopes as projection_slopes,
)
from .lens import (
    DISTORTION_MAX as DISTORTION_MAX,
    ideal_factors as ideal_factors,
    lens_of as lens_of,
    seen_factors as seen_factors,
    warped as warped,
)
from .noise import pose_noise_gain as pose_noise_gain
from .options import PoseOptions as PoseOptions
from .simulate import SimulatedPose as SimulatedPose, simulate_pose as simulate_pose
