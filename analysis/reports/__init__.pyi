from ._bench import (
    captures_section as captures_section,
    noise_section as noise_section,
    plot_focus_sweep as plot_focus_sweep,
    stage_section as stage_section,
    versions as versions,
)
from ._change_pictures import (
    ColourPair as ColourPair,
    compared_pictures as compared_pictures,
    depth_figure as depth_figure,
    limit_figure as limit_figure,
    view_figures as view_figures,
)
from ._change_series import series_report as series_report
from ._changes import (
    amplitude_text as amplitude_text,
    changes_report as changes_report,
    changes_section as changes_section,
    count_text as count_text,
    limit_section as limit_section,
    q_text as q_text,
    stored_changes_section as stored_changes_section,
    stored_pose_section as stored_pose_section,
)
from ._evaluation import (
    benchmark_report as benchmark_report,
    evaluation_figures as evaluation_figures,
    evaluation_report as evaluation_report,
    plot_changes as plot_changes,
    plot_detectability as plot_detectability,
    plot_limits as plot_limits,
    plot_pose as plot_pose,
)
from ._geometry import (
    geometry_sections as geometry_sections,
    geometry_verdicts as geometry_verdicts,
)
from ._lens import lens_report as lens_report
from ._noise import noise_report as noise_report
from ._page import (
    Report as Report,
    ReportSection as ReportSection,
    in_report_style as in_report_style,
    moment_text as moment_text,
    new_figure as new_figure,
    png_bytes as png_bytes,
    svg_bytes as svg_bytes,
    views_script as views_script,
    write_figure as write_figure,
)
from ._psf import (
    calibration_front as calibration_front,
    calibration_sections as calibration_sections,
    calibration_verdicts as calibration_verdicts,
    verdict_section as verdict_section,
)
from ._psf_edges import edge_csv as edge_csv, edge_table_section as edge_table_section
from ._psf_history import (
    HistoryEntry as HistoryEntry,
    history_document as history_document,
    history_sections as history_sections,
    ordered_history as ordered_history,
    plot_history as plot_history,
)
from ._session import (
    SessionNotes as SessionNotes,
    calibration_report as calibration_report,
    geometry_report as geometry_report,
    history_report as history_report,
    session_report as session_report,
)
from ._validation import (
    plot_curves as plot_curves,
    plot_furthest as plot_furthest,
    plot_images as plot_images,
    validation_report as validation_report,
)
from .psf_remarks import psf_remarks as psf_remarks
