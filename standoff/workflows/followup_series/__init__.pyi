from .pose_work import (
    PoseDemand as PoseDemand,
    RegisteredPose as RegisteredPose,
    beyond_curve_sentence as beyond_curve_sentence,
    judged_pose as judged_pose,
)
from .series import (
    CHANGES_TABLE as CHANGES_TABLE,
    FILES_OF_POSE_SERIES as FILES_OF_POSE_SERIES,
    FILES_OF_SERIES as FILES_OF_SERIES,
    POSES_TABLE as POSES_TABLE,
    SeriesRequest as SeriesRequest,
    SeriesResult as SeriesResult,
    find_changes_of_series as find_changes_of_series,
    holds_series as holds_series,
    is_series as is_series,
    judge_series as judge_series,
)

__all__ = [
    "CHANGES_TABLE",
    "FILES_OF_POSE_SERIES",
    "FILES_OF_SERIES",
    "POSES_TABLE",
    "PoseDemand",
    "RegisteredPose",
    "SeriesRequest",
    "SeriesResult",
    "beyond_curve_sentence",
    "find_changes_of_series",
    "holds_series",
    "is_series",
    "judge_series",
    "judged_pose",
]
