from ._frame_faults import FrameFaults as FrameFaults, frame_faults as frame_faults
from ._guidance import (
    TOLERANCES as TOLERANCES,
    Arrow as Arrow,
    PoseDeviation as PoseDeviation,
    pose_deviation as pose_deviation,
)
from ._limits import (
    FollowupPose as FollowupPose,
    PoseLimits as PoseLimits,
    ViewingCamera as ViewingCamera,
    contrast_found_at as contrast_found_at,
    limits_of_curve as limits_of_curve,
)
from ._parallax import (
    ParallaxCost as ParallaxCost,
    PoseParallax as PoseParallax,
    parallax_cost as parallax_cost,
)
from ._plot import limits_figure as limits_figure, pose_figure as pose_figure
from ._quality import (
    CONFIDENCE as CONFIDENCE,
    QUANTILE as QUANTILE,
    JudgedFollowup as JudgedFollowup,
    PoseDecision as PoseDecision,
    PoseQuality as PoseQuality,
    PoseSeries as PoseSeries,
    PoseSummary as PoseSummary,
    Verdict as Verdict,
    decide as decide,
    describe_pose as describe_pose,
    pose_quality as pose_quality,
    quality_of_scene as quality_of_scene,
    quality_with_depth as quality_with_depth,
    read_pose as read_pose,
    read_pose_series as read_pose_series,
    verdict_of as verdict_of,
)
from ._radial import RadialTerm as RadialTerm, straightened as straightened
from ._tracker import (
    FollowedPose as FollowedPose,
    PoseFollower as PoseFollower,
    PoseTracker as PoseTracker,
    PoseVerdict as PoseVerdict,
    StreamSummary as StreamSummary,
)
