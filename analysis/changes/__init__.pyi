from .chance import significance_threshold as significance_threshold
from .document import Change as Change, ChangeSummary as ChangeSummary, read_changes as read_changes
from .filter import (
    ChangeResult as ChangeResult,
    find_changes as find_changes,
)
from .options import ChangeOptions as ChangeOptions
from .plot import changes_figure as changes_figure
from .series import (
    ChangesSeries as ChangesSeries,
    ComparedFollowup as ComparedFollowup,
    read_changes_series as read_changes_series,
)

__all__ = [
    "Change",
    "ChangeOptions",
    "ChangeResult",
    "ChangeSummary",
    "ChangesSeries",
    "ComparedFollowup",
    "changes_figure",
    "find_changes",
    "read_changes",
    "read_changes_series",
    "significance_threshold",
]
