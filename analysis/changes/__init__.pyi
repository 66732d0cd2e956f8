from .document import (
    Change as Change,
    ChangeSummary as ChangeSummary,
    read_changes as read_changes,
)
from .filter import (
    ChangeResult as ChangeResult,
    find_changes as find_changes,
    significance_threshold as significance_threshold,
)
from .focus_sentence import describe_focus as describe_focus
from .options import ChangeOptions as ChangeOptions
from .plot import changes_figure as changes_figure
from .series import (
    ChangesSeries as ChangesSeries,
    ComparedFollowup as ComparedFollowup,
    read_changes_series as read_changes_series,
)
from .time_line import (
    ChangeTimeLine as ChangeTimeLine,
    ChangeTrack as ChangeTrack,
    TimeLineFollowup as TimeLineFollowup,
    TrackPoint as TrackPoint,
    read_time_line as read_time_line,
)
from .tracks import (
    PlaceReading as PlaceReading,
    TrackedFollowup as TrackedFollowup,
    track_changes as track_changes,
)

__all__ = [
    "Change",
    "ChangeOptions",
    "ChangeResult",
    "ChangeSummary",
    "ChangeTimeLine",
    "ChangeTrack",
    "ChangesSeries",
    "ComparedFollowup",
    "PlaceReading",
    "TimeLineFollowup",
    "TrackPoint",
    "TrackedFollowup",
    "changes_figure",
    "describe_focus",
    "find_changes",
    "read_changes",
    "read_changes_series",
    "read_time_line",
    "significance_threshold",
    "track_changes",
]
