from ._pose_work import (
    JudgedPose as JudgedPose,
    judge_pose as judge_pose,
)
from ._series import (
    CHANGES_TABLE as CHANGES_TABLE,
    FILES_OF_POSE_SERIES as FILES_OF_POSE_SERIES,
    FILES_OF_SERIES as FILES_OF_SERIES,
    POSES_TABLE as POSES_TABLE,
    SeriesResult as SeriesResult,
    find_changes_of_series as find_changes_of_series,
    holds_series as holds_series,
    is_series as is_series,
    judge_poses as judge_poses,
)
