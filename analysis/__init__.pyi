from .changes import (
    ChangeOptions as ChangeOptions,
    ChangeResult as ChangeResult,
    ChangeSummary as ChangeSummary,
    changes_between as changes_between,
)
from .detectability import (
    CurveChoice as CurveChoice,
    DetectabilityCurve as DetectabilityCurve,
    DetectabilityCurves as DetectabilityCurves,
    DetectionTask as DetectionTask,
    curves_of_images as curves_of_images,
)
from .errors import AnalysisError as AnalysisError
from .pose import (
    FollowupPose as FollowupPose,
    PoseLimits as PoseLimits,
    PoseQuality as PoseQuality,
    ViewingCamera as ViewingCamera,
    limits_of_curve as limits_of_curve,
    pose_quality as pose_quality,
)
from .validation import (
    Validation as Validation,
    ValidationSettings as ValidationSettings,
    validated as validated,
)
