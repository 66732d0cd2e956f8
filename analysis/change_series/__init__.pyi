from .stored_comparison import time_line_of as time_line_of
from .summary import (
    ChangesSeries as ChangesSeries,
    ComparedFollowup as ComparedFollowup,
    limit_columns as limit_columns,
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
