from .bench import (
    Bench as Bench,
    CapturedSession as CapturedSession,
    FoundFocus as FoundFocus,
    OpenBench as OpenBench,
    OpenCamera as OpenCamera,
    PlannedComparisons as PlannedComparisons,
    WatchedFocus as WatchedFocus,
    bench_config as bench_config,
    capture_session as capture_session,
    devices_of as devices_of,
    find_cameras as find_cameras,
    find_focus as find_focus,
    height_series as height_series,
    open_bench as open_bench,
    open_camera as open_camera,
    open_stage as open_stage,
    opened_camera as opened_camera,
    operate_stage as operate_stage,
    place_in_simulation as place_in_simulation,
    place_target as place_target,
    preview_plan as preview_plan,
    refuse_half_simulated as refuse_half_simulated,
    watch_focus as watch_focus,
)
from .benchmark import (
    SCORE_FILES as SCORE_FILES,
    MadeBenchmark as MadeBenchmark,
    ScoredBenchmark as ScoredBenchmark,
    make_benchmark as make_benchmark,
    score_benchmark as score_benchmark,
)
from .call import Call as Call, Progress as Progress
from .caller import called_as as called_as, login_name as login_name
from .choices import (
    BenchmarkSize as BenchmarkSize,
    ChangeSigns as ChangeSigns,
    PairFormat as PairFormat,
)
from .comparison import (
    CHANGE_FILES as CHANGE_FILES,
    AlignmentHints as AlignmentHints,
    ComparedPhotographs as ComparedPhotographs,
    DetectionLimitOptions as DetectionLimitOptions,
    FeatureMatches as FeatureMatches,
    RegistrationHints as RegistrationHints,
    alignment_hints as alignment_hints,
    find_changes as find_changes,
    register as register,
)
from .detectability import (
    CurveChoice as CurveChoice,
    CurveLike as CurveLike,
    DetectionTask as DetectionTask,
    JudgedHomography as JudgedHomography,
    MeasuredCurves as MeasuredCurves,
    curve_figure_paths as curve_figure_paths,
    curve_table_path as curve_table_path,
    curves_made_by as curves_made_by,
    d_prime_curves as d_prime_curves,
    given_curve as given_curve,
    judge_homography as judge_homography,
    measure_curves as measure_curves,
    pose_limits as pose_limits,
    state_of_curves as state_of_curves,
)
from .evaluation import (
    ChangePairs as ChangePairs,
    ChangePairsTask as ChangePairsTask,
    EvaluatedDetector as EvaluatedDetector,
    EvaluationTask as EvaluationTask,
    LearnedDetector as LearnedDetector,
    Patch as Patch,
    Spot as Spot,
    TrainingOptions as TrainingOptions,
    change_pairs as change_pairs,
    evaluate as evaluate,
    evaluation_figure_paths as evaluation_figure_paths,
    evaluation_made_by as evaluation_made_by,
    patch_of as patch_of,
    read_change_pairs as read_change_pairs,
    train_detector as train_detector,
)
from .files import (
    RESULTS_FOLDER as RESULTS_FOLDER,
    make_folder as make_folder,
    require_writable as require_writable,
    write_figure as write_figure,
    write_file as write_file,
)
from .followup import (
    CaptureOptions as CaptureOptions,
    SimulatedPhotograph as SimulatedPhotograph,
    UncertaintyOptions as UncertaintyOptions,
    simulate as simulate,
    simulate_pose as simulate_pose,
    zoom_out as zoom_out,
)
from .geometry import calibrate_geometry as calibrate_geometry, write_geometry as write_geometry
from .inputs import (
    FilePath as FilePath,
    NoiseLike as NoiseLike,
    PsfLike as PsfLike,
    camera_noise as camera_noise,
    path_of as path_of,
)
from .noise import measure_noise as measure_noise, write_noise as write_noise
from .photographs import read_image as read_image, reading as reading
from .pose_stream import NamedFrame as NamedFrame, PoseWatch as PoseWatch
from .psf import (
    GaussianPsf as GaussianPsf,
    PsfComparison as PsfComparison,
    PsfHistory as PsfHistory,
    Reading as Reading,
    Session as Session,
    TabulatedPsf as TabulatedPsf,
    calibrate_psf as calibrate_psf,
    compare_psfs as compare_psfs,
    edge_image as edge_image,
    measure_edges as measure_edges,
    opened_psf as opened_psf,
    psf_history as psf_history,
    read_psf as read_psf,
    write_edge_table as write_edge_table,
    write_psf as write_psf,
)
from .rehearsal import (
    DEMO_FILES as DEMO_FILES,
    DEMO_PHOTOGRAPHS as DEMO_PHOTOGRAPHS,
    DemoResult as DemoResult,
    run_demo as run_demo,
    run_paper as run_paper,
    short_bench as short_bench,
)
from .series import (
    CHANGES_TABLE as CHANGES_TABLE,
    FILES_OF_POSE_SERIES as FILES_OF_POSE_SERIES,
    FILES_OF_SERIES as FILES_OF_SERIES,
    POSES_TABLE as POSES_TABLE,
    JudgedPose as JudgedPose,
    SeriesResult as SeriesResult,
    find_changes_of_series as find_changes_of_series,
    holds_series as holds_series,
    is_series as is_series,
    judge_pose as judge_pose,
    judge_poses as judge_poses,
)
from .sessions import (
    VALIDATION_FILES as VALIDATION_FILES,
    ExportedSession as ExportedSession,
    ImportedPhotographs as ImportedPhotographs,
    VerifiedSession as VerifiedSession,
    WrittenReport as WrittenReport,
    add_note as add_note,
    correct_height as correct_height,
    default_models as default_models,
    exclude_capture as exclude_capture,
    export_session as export_session,
    import_photographs as import_photographs,
    include_capture as include_capture,
    list_sessions as list_sessions,
    set_aside_files as set_aside_files,
    show_session as show_session,
    validate as validate,
    verify_session as verify_session,
    write_report as write_report,
)
from .sr_pairs import (
    SrDatasetSummary as SrDatasetSummary,
    SweepOptions as SweepOptions,
    training_pairs as training_pairs,
)
from .study import plan_study as plan_study, write_study as write_study
