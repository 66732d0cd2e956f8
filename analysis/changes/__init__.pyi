from .document import ChangeSummary as ChangeSummary, read_changes as read_changes
from .filter import (
    ChangeOptions as ChangeOptions,
    ChangeResult as ChangeResult,
    find_changes as find_changes,
    significance_threshold as significance_threshold,
)
from .plot import changes_figure as changes_figure

__all__ = [
    "ChangeOptions",
    "ChangeResult",
    "ChangeSummary",
    "changes_figure",
    "find_changes",
    "read_changes",
    "significance_threshold",
]
