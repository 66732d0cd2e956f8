from .errors import ArgumentError as ArgumentError
from .library.bench import (
    Bench as Bench,
    capture_session as capture_session,
    find_cameras as find_cameras,
    find_focus as find_focus,
    preview_plan as preview_plan,
    watch_focus as watch_focus,
)
from .library.benchmark import (
    make_benchmark as make_benchmark,
    score_benchmark as score_benchmark,
)
from .library.call import Progress as Progress
from .library.comparison import (
    DetectionLimitOptions as DetectionLimitOptions,
    FeatureMatches as FeatureMatches,
    RegistrationHints as RegistrationHints,
    alignment_hints as alignment_hints,
    find_changes as find_changes,
    register as register,
)
from .library.detectability import (
    CurveChoice as CurveChoice,
    DetectionTask as DetectionTask,
    d_prime_curves as d_prime_curves,
    judge_homography as judge_homography,
    measure_curves as measure_curves,
    pose_limits as pose_limits,
)
from .library.evaluation import (
    ChangePairsTask as ChangePairsTask,
    EvaluationTask as EvaluationTask,
    Spot as Spot,
    TrainingOptions as TrainingOptions,
    change_pairs as change_pairs,
    evaluate as evaluate,
    patch_of as patch_of,
    read_change_pairs as read_change_pairs,
    train_detector as train_detector,
)
from .library.example_photographs import example_photographs as example_photographs
from .library.followup import (
    CaptureOptions as CaptureOptions,
    UncertaintyOptions as UncertaintyOptions,
    simulate as simulate,
    simulate_pose as simulate_pose,
    zoom_out as zoom_out,
)
from .library.geometry import (
    calibrate_geometry as calibrate_geometry,
    write_geometry as write_geometry,
)
from .library.noise import measure_noise as measure_noise, write_noise as write_noise
from .library.photographs import read_image as read_image, reading as reading
from .library.pose_stream import PoseWatch as PoseWatch
from .library.psf import (
    GaussianPsf as GaussianPsf,
    Session as Session,
    TabulatedPsf as TabulatedPsf,
    calibrate_psf as calibrate_psf,
    compare_psfs as compare_psfs,
    measure_edges as measure_edges,
    psf_history as psf_history,
    read_psf as read_psf,
    write_edge_table as write_edge_table,
    write_psf as write_psf,
)
from .library.series import (
    find_changes_of_series as find_changes_of_series,
    judge_pose as judge_pose,
    judge_poses as judge_poses,
)
from .library.sessions import (
    add_note as add_note,
    correct_height as correct_height,
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
from .library.sr_pairs import SweepOptions as SweepOptions, training_pairs as training_pairs
from .library.study import plan_study as plan_study, write_study as write_study

__version__: str
