from acquisition import Session as Session
from acquisition.files import (
    RESULTS_FOLDER as RESULTS_FOLDER,
    make_folder as make_folder,
    require_writable as require_writable,
    write_file as write_file,
)
from analysis.choices import (
    BenchmarkSize as BenchmarkSize,
    ChangeSigns as ChangeSigns,
    PairFormat as PairFormat,
)
from analysis.detectability import CurveChoice as CurveChoice
from analysis.followup_series import SeriesResult as SeriesResult
from calibration.files import (
    read_depth as read_depth,
    write_geometry as write_geometry,
    write_noise as write_noise,
    write_psf as write_psf,
)
from simulation.arguments import FilePath as FilePath, path_of as path_of

from .bench import (
    Bench as Bench,
    PlannedComparisons as PlannedComparisons,
    WatchedFocus as WatchedFocus,
    capture_session as capture_session,
    devices_of as devices_of,
    find_cameras as find_cameras,
    find_focus as find_focus,
    height_series as height_series,
    open_bench as open_bench,
    open_camera as open_camera,
    open_stage as open_stage,
    operate_stage as operate_stage,
    place_in_simulation as place_in_simulation,
    preview_plan as preview_plan,
    refuse_half_simulated as refuse_half_simulated,
    watch_focus as watch_focus,
)
from .benchmark import (
    SCORE_FILES as SCORE_FILES,
    ScoredBenchmark as ScoredBenchmark,
    make_benchmark as make_benchmark,
    score_benchmark as score_benchmark,
)
from .call import (
    Call as Call,
    NoiseLike as NoiseLike,
    PsfLike as PsfLike,
    camera_noise as camera_noise,
)
from .caller import called_as as called_as, login_name as login_name
from .changes import CHANGE_FILES as CHANGE_FILES, find_changes as find_changes
from .detectability import (
    JudgedHomography as JudgedHomography,
    given_curve as given_curve,
    judge_homography as judge_homography,
    known_errors as known_errors,
    pose_limits as pose_limits,
    read_any_curves as read_any_curves,
)
from .edges import (
    Reading as Reading,
    edge_image as edge_image,
    write_edge_table as write_edge_table,
)
from .evaluation import (
    Spot as Spot,
    change_pairs as change_pairs,
    evaluate as evaluate,
    evaluation_figure_paths as evaluation_figure_paths,
    evaluation_made_by as evaluation_made_by,
    patch_of as patch_of,
)
from .geometry import calibrate_geometry as calibrate_geometry
from .lens import measure_lens as measure_lens, write_lens as write_lens
from .limit_options import DetectionLimitOptions as DetectionLimitOptions
from .measured_curves import (
    curve_figure_paths as curve_figure_paths,
    curve_table_path as curve_table_path,
    curves_made_by as curves_made_by,
    measure_curves as measure_curves,
    state_of_curves as state_of_curves,
)
from .noise import measure_noise as measure_noise
from .photographs import reading as reading
from .pose_stream import NamedFrame as NamedFrame, PoseWatch as PoseWatch
from .psf import opened_psf as opened_psf
from .psf_calibration import calibrate_psf as calibrate_psf
from .psf_comparison import compare_psfs as compare_psfs, psf_history as psf_history
from .registration import alignment_hints as alignment_hints
from .rehearsal import (
    DEMO_FILES as DEMO_FILES,
    LANTERN_PHOTOGRAPHS as LANTERN_PHOTOGRAPHS,
    DemoResult as DemoResult,
    run_demo as run_demo,
    run_paper as run_paper,
)
from .series import (
    CHANGES_TABLE as CHANGES_TABLE,
    FILES_OF_POSE_SERIES as FILES_OF_POSE_SERIES,
    FILES_OF_SERIES as FILES_OF_SERIES,
    POSES_TABLE as POSES_TABLE,
    find_changes_of_series as find_changes_of_series,
    holds_series as holds_series,
    is_series as is_series,
    judge_pose as judge_pose,
    judge_poses as judge_poses,
)
from .sessions import (
    add_note as add_note,
    correct_height as correct_height,
    exclude_capture as exclude_capture,
    export_session as export_session,
    import_photographs as import_photographs,
    include_capture as include_capture,
    list_sessions as list_sessions,
    set_aside_files as set_aside_files,
    show_session as show_session,
    verify_session as verify_session,
)
from .simulated_photograph import (
    SimulatedPhotograph as SimulatedPhotograph,
    UncertaintyOptions as UncertaintyOptions,
)
from .simulation import CaptureOptions as CaptureOptions, simulate as simulate
from .sr_pairs import training_pairs as training_pairs
from .study import plan_study as plan_study, write_study as write_study
from .validation import (
    VALIDATION_FILES as VALIDATION_FILES,
    validate as validate,
    write_report as write_report,
)
