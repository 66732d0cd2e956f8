from .homography import (
    homography_fault as homography_fault,
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
from .local_poses import poses_at_followup as poses_at_followup
from .missing_blur import derivatives as derivatives
from .noise import pose_noise_gain as pose_noise_gain
from .options import PoseOptions as PoseOptions
from .prefilter import LocalPose as LocalPose
from .simulate import SimulatedPose as SimulatedPose, simulate_pose as simulate_pose
from .view import PoseView as PoseView
