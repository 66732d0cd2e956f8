from .decision import (
    CONFIDENCE as CONFIDENCE,
    PoseDecision as PoseDecision,
    Verdict as Verdict,
    decide as decide,
    verdict_of as verdict_of,
)
from .limits import (
    PoseLimits as PoseLimits,
    contrast_found_at as contrast_found_at,
    pose_limits as pose_limits,
)
from .plot import limits_figure as limits_figure, pose_figure as pose_figure
from .pose_sentence import describe_pose as describe_pose
from .quality import (
    QUANTILE as QUANTILE,
    PoseQuality as PoseQuality,
    PoseSummary as PoseSummary,
    judge_pose as judge_pose,
    read_pose as read_pose,
)
from .series import (
    JudgedFollowup as JudgedFollowup,
    PoseSeries as PoseSeries,
    read_pose_series as read_pose_series,
)
from .stream import StreamSummary as StreamSummary
from .tracker import PoseTracker as PoseTracker, PoseVerdict as PoseVerdict
from .viewing_camera import FollowupPose as FollowupPose, ViewingCamera as ViewingCamera
