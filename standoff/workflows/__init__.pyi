from .camera_calibration import (
    CalibrationRequest as CalibrationRequest,
    calibrate_camera as calibrate_camera,
)
from .comparison import (
    CHANGE_FILES as CHANGE_FILES,
    AlignmentHints as AlignmentHints,
    ComparedPair as ComparedPair,
    ComparisonRequest as ComparisonRequest,
    HintFiles as HintFiles,
    find_changes_of_files as find_changes_of_files,
    read_hints as read_hints,
    write_changes as write_changes,
)
from .demo import (
    DEMO_FILES as DEMO_FILES,
    DemoResult as DemoResult,
    run_demo as run_demo,
)
from .detectability_run import (
    CurvesRequest as CurvesRequest,
    MeasuredCurves as MeasuredCurves,
    curve_figure_paths as curve_figure_paths,
    measure_curves as measure_curves,
    write_curve_figures as write_curve_figures,
)
from .devices import (
    OpenBench as OpenBench,
    open_bench as open_bench,
    open_camera as open_camera,
    open_stage as open_stage,
    place_in_simulation as place_in_simulation,
    refuse_half_simulated as refuse_half_simulated,
)
from .edge_sources import Reading as Reading, edge_image as edge_image
from .figure_files import write_figure as write_figure
from .focus_runs import (
    FocusSweep as FocusSweep,
    OpenCamera as OpenCamera,
    SweepRequest as SweepRequest,
    opened_camera as opened_camera,
    run_sweep as run_sweep,
    sweep_bench as sweep_bench,
    watch_focus as watch_focus,
)
from .followup import (
    CaptureOptions as CaptureOptions,
    FollowUp as FollowUp,
    zoomed_out as zoomed_out,
)
from .followup_series import (
    CHANGES_TABLE as CHANGES_TABLE,
    FILES_OF_POSE_SERIES as FILES_OF_POSE_SERIES,
    FILES_OF_SERIES as FILES_OF_SERIES,
    POSES_TABLE as POSES_TABLE,
    PoseDemand as PoseDemand,
    RegisteredPose as RegisteredPose,
    SeriesRequest as SeriesRequest,
    SeriesResult as SeriesResult,
    beyond_curve_sentence as beyond_curve_sentence,
    find_changes_of_series as find_changes_of_series,
    holds_series as holds_series,
    is_series as is_series,
    judge_series as judge_series,
    judged_pose as judged_pose,
)
from .image_files import (
    each_image as each_image,
    expanded_images as expanded_images,
    write_float_tiff as write_float_tiff,
    write_mask as write_mask,
)
from .output_files import (
    RESULTS_FOLDER as RESULTS_FOLDER,
    make_folder as make_folder,
    make_results_folder as make_results_folder,
    require_writable as require_writable,
    write_file as write_file,
    written_together as written_together,
)
from .paper import (
    place_errors_px as place_errors_px,
    run_paper as run_paper,
    short_bench as short_bench,
)
from .photograph_import import (
    ImportSettings as ImportSettings,
    import_into_session as import_into_session,
)
from .planned_comparison import PlannedComparisons as PlannedComparisons
from .pose_stream import (
    NamedFrame as NamedFrame,
    StreamSummary as StreamSummary,
    camera_frames as camera_frames,
    folder_frames as folder_frames,
    judge_stream as judge_stream,
    verdict_display as verdict_display,
    verdict_facts as verdict_facts,
)
from .practice import (
    PracticeCommandError as PracticeCommandError,
    PracticeConsole as PracticeConsole,
)
from .provenance import (
    provenance_of as provenance_of,
)
from .psf_files import psf_and_field as psf_and_field, read_camera_psf as read_camera_psf
from .reports import (
    write_calibration_report as write_calibration_report,
    write_geometry_report as write_geometry_report,
    write_page as write_page,
)
from .session_export import (
    EXPORT_ENDINGS as EXPORT_ENDINGS,
    ExportFormat as ExportFormat,
    ExportRequest as ExportRequest,
    ExportSummary as ExportSummary,
    export_session as export_session,
    require_exporter as require_exporter,
)
from .session_report import write_session_report as write_session_report
from .simulated_photograph import (
    FollowUpRequest as FollowUpRequest,
    FoundKernel as FoundKernel,
    SimulatedPhotograph as SimulatedPhotograph,
    simulate_photograph as simulate_photograph,
)
from .sr_dataset import (
    PairFormat as PairFormat,
    SrDatasetSettings as SrDatasetSettings,
    SrDatasetSummary as SrDatasetSummary,
    write_sr_dataset as write_sr_dataset,
)
from .validation_run import (
    VALIDATION_FILES as VALIDATION_FILES,
    default_models as default_models,
    run_validation as run_validation,
)

__all__ = [
    "CHANGES_TABLE",
    "CHANGE_FILES",
    "DEMO_FILES",
    "EXPORT_ENDINGS",
    "FILES_OF_POSE_SERIES",
    "FILES_OF_SERIES",
    "POSES_TABLE",
    "RESULTS_FOLDER",
    "VALIDATION_FILES",
    "AlignmentHints",
    "CalibrationRequest",
    "CaptureOptions",
    "ComparedPair",
    "ComparisonRequest",
    "CurvesRequest",
    "DemoResult",
    "ExportFormat",
    "ExportRequest",
    "ExportSummary",
    "FocusSweep",
    "FollowUp",
    "FollowUpRequest",
    "FoundKernel",
    "HintFiles",
    "ImportSettings",
    "MeasuredCurves",
    "NamedFrame",
    "OpenBench",
    "OpenCamera",
    "PairFormat",
    "PlannedComparisons",
    "PoseDemand",
    "PracticeCommandError",
    "PracticeConsole",
    "Reading",
    "RegisteredPose",
    "SeriesRequest",
    "SeriesResult",
    "SimulatedPhotograph",
    "SrDatasetSettings",
    "SrDatasetSummary",
    "StreamSummary",
    "SweepRequest",
    "beyond_curve_sentence",
    "calibrate_camera",
    "camera_frames",
    "curve_figure_paths",
    "default_models",
    "each_image",
    "edge_image",
    "expanded_images",
    "export_session",
    "find_changes_of_files",
    "find_changes_of_series",
    "folder_frames",
    "holds_series",
    "import_into_session",
    "is_series",
    "judge_series",
    "judge_stream",
    "judged_pose",
    "make_folder",
    "make_results_folder",
    "measure_curves",
    "open_bench",
    "open_camera",
    "open_stage",
    "opened_camera",
    "place_errors_px",
    "place_in_simulation",
    "provenance_of",
    "psf_and_field",
    "read_camera_psf",
    "read_hints",
    "refuse_half_simulated",
    "require_exporter",
    "require_writable",
    "run_demo",
    "run_paper",
    "run_sweep",
    "run_validation",
    "short_bench",
    "simulate_photograph",
    "sweep_bench",
    "verdict_display",
    "verdict_facts",
    "watch_focus",
    "write_calibration_report",
    "write_changes",
    "write_curve_figures",
    "write_figure",
    "write_file",
    "write_float_tiff",
    "write_geometry_report",
    "write_mask",
    "write_page",
    "write_session_report",
    "write_sr_dataset",
    "written_together",
    "zoomed_out",
]
