from ._prefilter import LocalPose as LocalPose
from ._view_filter import pose_noise_gain as pose_noise_gain
from ._warp import (
    DISTORTION_MAX as DISTORTION_MAX,
    derivatives as derivatives,
    homography_fault as homography_fault,
    ideal_factors as ideal_factors,
    ideal_points as ideal_points,
    lens_of as lens_of,
    project as project,
    projection_depth as projection_depth,
    projection_slopes as projection_slopes,
    seen_factors as seen_factors,
    warped as warped,
)
from .depth import (
    DepthView as DepthView,
    SceneDepth as SceneDepth,
)
from .depth_simulation import (
    DepthRendering as DepthRendering,
    DepthSampling as DepthSampling,
)
from .simulate import (
    SimulatedPose as SimulatedPose,
    simulate_pose_of_image as simulate_pose_of_image,
)
from .view import (
    PoseOptions as PoseOptions,
    PoseView as PoseView,
    poses_at_followup as poses_at_followup,
)
