from .bench import (
    captures_section as captures_section,
    device_rows as device_rows,
    noise_section as noise_section,
    stage_section as stage_section,
)
from .changes import (
    changes_section as changes_section,
    compared_pictures as compared_pictures,
    count_text as count_text,
    q_text as q_text,
    render_changes_report as render_changes_report,
    render_series_report as render_series_report,
    stored_changes_section as stored_changes_section,
    stored_pose_section as stored_pose_section,
    view_figures as view_figures,
)
from .focus import plot_focus_sweep as plot_focus_sweep
from .geometry import geometry_sections as geometry_sections, geometry_verdicts as geometry_verdicts
from .noise import render_noise_report as render_noise_report
from .page import (
    Report as Report,
    ReportSection as ReportSection,
    in_report_style as in_report_style,
    new_figure as new_figure,
    png_bytes as png_bytes,
    render_report as render_report,
    svg_bytes as svg_bytes,
)
from .psf import (
    calibration_front as calibration_front,
    calibration_sections as calibration_sections,
    calibration_verdicts as calibration_verdicts,
    edge_table_section as edge_table_section,
    history_document as history_document,
    history_sections as history_sections,
    ordered_history as ordered_history,
    verdict_section as verdict_section,
)
from .results import (
    plot_changes as plot_changes,
    plot_detectability as plot_detectability,
    plot_limits as plot_limits,
    plot_pose as plot_pose,
)
from .session import (
    SessionNotes as SessionNotes,
    render_session_report as render_session_report,
    versions as versions,
)
from .validation import render_validation as render_validation
from .validation_plots import (
    plot_curves as plot_curves,
    plot_furthest as plot_furthest,
    plot_images as plot_images,
)

__all__ = [
    "Report",
    "ReportSection",
    "SessionNotes",
    "calibration_front",
    "calibration_sections",
    "calibration_verdicts",
    "captures_section",
    "changes_section",
    "compared_pictures",
    "count_text",
    "device_rows",
    "edge_table_section",
    "geometry_sections",
    "geometry_verdicts",
    "history_document",
    "history_sections",
    "in_report_style",
    "new_figure",
    "noise_section",
    "ordered_history",
    "plot_changes",
    "plot_curves",
    "plot_detectability",
    "plot_focus_sweep",
    "plot_furthest",
    "plot_images",
    "plot_limits",
    "plot_pose",
    "png_bytes",
    "q_text",
    "render_changes_report",
    "render_noise_report",
    "render_report",
    "render_series_report",
    "render_session_report",
    "render_validation",
    "stage_section",
    "stored_changes_section",
    "stored_pose_section",
    "svg_bytes",
    "verdict_section",
    "versions",
    "view_figures",
]
