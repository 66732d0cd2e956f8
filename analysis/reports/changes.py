"""Picture of what changed, as reports and commands show it."""

from analysis.changes import changes_figure
from analysis.reports.page import in_report_style

__all__ = ["plot_changes"]

plot_changes = in_report_style(changes_figure)
