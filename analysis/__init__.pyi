from .changes import (
    ChangeOptions as ChangeOptions,
    ChangeResult as ChangeResult,
    ChangeSummary as ChangeSummary,
    find_changes as find_changes,
)
from .detectability import (
    CurveChoice as CurveChoice,
    DetectabilityCurve as DetectabilityCurve,
    DetectabilityCurves as DetectabilityCurves,
    DetectionTask as DetectionTask,
    d_prime_curves as d_prime_curves,
)
from .errors import AnalysisError as AnalysisError
from .pose import (
    FollowupPose as FollowupPose,
    PoseLimits as PoseLimits,
    PoseQuality as PoseQuality,
    ViewingCamera as ViewingCamera,
    judge_pose as judge_pose,
    pose_limits as pose_limits,
)
from .validation import (
    Validation as Validation,
    ValidationSettings as ValidationSettings,
    validate as validate,
)
