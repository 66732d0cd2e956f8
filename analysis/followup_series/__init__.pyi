from .folder_names import FolderNames as FolderNames
from .record import FollowupRecord as FollowupRecord
from .rows import CommittedRows as CommittedRows, Row as Row, is_refused as is_refused
from .series import (
    SUMMARY_NAME as SUMMARY_NAME,
    SeriesResult as SeriesResult,
    SeriesTables as SeriesTables,
    run_series as run_series,
)
from .work import (
    STATE_NAME as STATE_NAME,
    FollowupPhotograph as FollowupPhotograph,
    FollowupWork as FollowupWork,
    References as References,
    Written as Written,
)
