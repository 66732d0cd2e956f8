"""Figures of results in the style of reports."""

from analysis.changes import changes_figure
from analysis.detectability import curves_figure
from analysis.pose import limits_figure, pose_figure
from analysis.reports.page import in_report_style

plot_changes = in_report_style(changes_figure)
plot_detectability = in_report_style(curves_figure)
plot_limits = in_report_style(limits_figure)
plot_pose = in_report_style(pose_figure)
