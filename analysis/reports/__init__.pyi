from .bench import (
    captures_section as captures_section,
    noise_section as noise_section,
    stage_section as stage_section,
)
from .benchmark import render_benchmark_report as render_benchmark_report
from .calibrations import (
    render_calibration_report as render_calibration_report,
    render_geometry_report as render_geometry_report,
    render_history_report as render_history_report,
)
from .changes import (
    ColourPair as ColourPair,
    changes_section as changes_section,
    compared_pictures as compared_pictures,
    count_text as count_text,
    limit_figure as limit_figure,
    limit_section as limit_section,
    q_text as q_text,
    render_changes_report as render_changes_report,
    render_series_report as render_series_report,
    stored_changes_section as stored_changes_section,
    stored_pose_section as stored_pose_section,
    view_figures as view_figures,
)
from .evaluation import (
    evaluation_figures as evaluation_figures,
    render_evaluation_report as render_evaluation_report,
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
    views_script as views_script,
    write_figure as write_figure,
)
from .psf import (
    HistoryEntry as HistoryEntry,
    calibration_front as calibration_front,
    calibration_sections as calibration_sections,
    calibration_verdicts as calibration_verdicts,
    edge_csv as edge_csv,
    edge_table_section as edge_table_section,
    history_document as history_document,
    history_sections as history_sections,
    ordered_history as ordered_history,
    plot_history as plot_history,
    psf_remarks as psf_remarks,
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
