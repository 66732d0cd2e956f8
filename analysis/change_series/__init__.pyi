from .time_line import (
    ChangesSeries as ChangesSeries,
    ChangeTimeLine as ChangeTimeLine,
    ChangeTrack as ChangeTrack,
    ComparedFollowup as ComparedFollowup,
    TimeLineFollowup as TimeLineFollowup,
    TrackPoint as TrackPoint,
    limit_columns as limit_columns,
    read_changes_series as read_changes_series,
    read_time_line as read_time_line,
)
from .tracks import (
    PlaceReading as PlaceReading,
    TrackedFollowup as TrackedFollowup,
    time_line_of as time_line_of,
    track_changes as track_changes,
)
