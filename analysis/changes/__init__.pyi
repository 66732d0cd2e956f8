from .document import ChangeSummary as ChangeSummary, read_changes as read_changes
from .filter import (
    ChangeResult as ChangeResult,
    find_changes as find_changes,
    significance_threshold as significance_threshold,
)
from .options import ChangeOptions as ChangeOptions
from .plot import changes_figure as changes_figure
from .series import (
    ChangesSeries as ChangesSeries,
    ComparedFollowup as ComparedFollowup,
    read_changes_series as read_changes_series,
)

__all__ = [
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
