from .pose_work import (
    PoseDemand as PoseDemand,
    RegisteredPose as RegisteredPose,
    beyond_curve_sentence as beyond_curve_sentence,
    judged_pose as judged_pose,
)
from .series import (
    SeriesRequest as SeriesRequest,
    SeriesResult as SeriesResult,
    find_changes_of_series as find_changes_of_series,
    is_series as is_series,
    judge_series as judge_series,
)

__all__ = [
    "PoseDemand",
    "RegisteredPose",
    "SeriesRequest",
    "SeriesResult",
    "beyond_curve_sentence",
    "find_changes_of_series",
    "is_series",
    "judge_series",
    "judged_pose",
]
