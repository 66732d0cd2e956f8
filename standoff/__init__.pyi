from acquisition import Session as Session
from acquisition.aravis import FoundCamera as FoundCamera
from acquisition.bench import BenchConfig as BenchConfig, BenchDevices as BenchDevices
from acquisition.capture import (
    CaptureProgress as CaptureProgress,
    PlanPreview as PlanPreview,
    QualityFinding as QualityFinding,
)
from acquisition.devices import Camera as Camera, Stage as Stage
from acquisition.focus import (
    FocusPeak as FocusPeak,
    FocusPoint as FocusPoint,
    FocusReading as FocusReading,
)
from acquisition.photographs import (
    BenchCapture as BenchCapture,
    Photograph as Photograph,
    ReadOptions as ReadOptions,
)
from acquisition.plan import (
    CapturePlan as CapturePlan,
    PlanEntry as PlanEntry,
    PlanEstimate as PlanEstimate,
)
from acquisition.session import (
    CaptureImages as CaptureImages,
    CaptureRecord as CaptureRecord,
    JournalEvent as JournalEvent,
    Manifest as Manifest,
    SessionCapture as SessionCapture,
)
from analysis.benchmark import BenchmarkScores as BenchmarkScores, read_scores as read_scores
from analysis.change_series import (
    ChangesSeries as ChangesSeries,
    ChangeTimeLine as ChangeTimeLine,
    ComparedFollowup as ComparedFollowup,
    read_changes_series as read_changes_series,
    read_time_line as read_time_line,
)
from analysis.changes import ChangeSummary as ChangeSummary, read_changes as read_changes
from analysis.detectability import (
    ChangeSignal as ChangeSignal,
    CurveChoice as CurveChoice,
    DetectabilityCurve as DetectabilityCurve,
    DetectabilityCurves as DetectabilityCurves,
    DetectionTask as DetectionTask,
    ErrorSources as ErrorSources,
    SweepPlan as SweepPlan,
    read_curves as read_curves,
)
from analysis.detectors import Detector as Detector
from analysis.detectors.learned import (
    LearnedDetector as LearnedDetector,
    TrainingOptions as TrainingOptions,
    TrainingPair as TrainingPair,
    load_learned as load_learned,
    train_detector as train_detector,
)
from analysis.evaluation import (
    Condition as Condition,
    Evaluation as Evaluation,
    PaintedChange as PaintedChange,
    read_evaluation as read_evaluation,
)
from analysis.evaluation.change_pairs import ChangePairsDataset as ChangePairsDataset
from analysis.followup_series import SeriesResult as SeriesResult
from analysis.pose import (
    JudgedFollowup as JudgedFollowup,
    PoseSeries as PoseSeries,
    PoseSummary as PoseSummary,
    PoseVerdict as PoseVerdict,
    StreamSummary as StreamSummary,
    read_pose as read_pose,
    read_pose_series as read_pose_series,
)
from analysis.study import PlanStudy as PlanStudy, read_study as read_study
from analysis.validation import Validation as Validation, read_validation as read_validation
from calibration.edges import EdgeMeasurement as EdgeMeasurement, Region as Region
from calibration.files import (
    read_correction as read_correction,
    read_depth as read_depth,
    read_geometry as read_geometry,
    read_homography as read_homography,
    read_noise as read_noise,
    read_psf as read_psf,
    write_geometry as write_geometry,
    write_homography as write_homography,
    write_noise as write_noise,
    write_psf as write_psf,
)
from calibration.geometry import (
    CharucoBoard as CharucoBoard,
    GeometryCalibration as GeometryCalibration,
)
from calibration.lens import LensMeasurement as LensMeasurement
from calibration.noise import (
    CorrectionMaps as CorrectionMaps,
    NoiseCalibration as NoiseCalibration,
    NoiseMeasurement as NoiseMeasurement,
)
from calibration.psf import PsfCalibration as PsfCalibration
from calibration.registration import (
    FeatureMatches as FeatureMatches,
    Homography as Homography,
    Registration as Registration,
    RegistrationHints as RegistrationHints,
)
from hil_mocks import SimulatedBench as SimulatedBench
from simulation import GaussianPsf as GaussianPsf, TabulatedPsf as TabulatedPsf
from simulation.capture_noise import CaptureNoise as CaptureNoise
from simulation.pose import SceneDepth as SceneDepth, SimulatedPose as SimulatedPose
from simulation.psf import MeasuredPsf as MeasuredPsf, Psf as Psf, SeparablePsf as SeparablePsf

from .errors import ArgumentError as ArgumentError
from .library.bench import (
    Bench as Bench,
    CapturedSession as CapturedSession,
    FoundFocus as FoundFocus,
    WatchedFocus as WatchedFocus,
    capture_session as capture_session,
    find_cameras as find_cameras,
    find_focus as find_focus,
    preview_plan as preview_plan,
    watch_focus as watch_focus,
)
from .library.benchmark import (
    MadeBenchmark as MadeBenchmark,
    ScoredBenchmark as ScoredBenchmark,
    make_benchmark as make_benchmark,
    score_benchmark as score_benchmark,
)
from .library.call import Progress as Progress
from .library.changes import (
    ComparedPhotographs as ComparedPhotographs,
    find_changes as find_changes,
)
from .library.detectability import (
    AllowedMovement as AllowedMovement,
    JudgedHomography as JudgedHomography,
    d_prime_curves as d_prime_curves,
    judge_homography as judge_homography,
    pose_limits as pose_limits,
    write_curves as write_curves,
)
from .library.edges import (
    measure_edges as measure_edges,
    write_edge_table as write_edge_table,
)
from .library.evaluation import (
    ChangePairs as ChangePairs,
    ChangePairsTask as ChangePairsTask,
    EvaluatedDetector as EvaluatedDetector,
    EvaluationTask as EvaluationTask,
    Patch as Patch,
    Spot as Spot,
    change_pairs as change_pairs,
    evaluate as evaluate,
    patch_of as patch_of,
    read_change_pairs as read_change_pairs,
)
from .library.geometry import (
    calibrate_geometry as calibrate_geometry,
)
from .library.lens import measure_lens as measure_lens, write_lens as write_lens
from .library.limit_options import DetectionLimitOptions as DetectionLimitOptions
from .library.measured_curves import (
    MeasuredCurves as MeasuredCurves,
    measure_curves as measure_curves,
)
from .library.noise import measure_noise as measure_noise
from .library.photographs import (
    ExamplePhotographs as ExamplePhotographs,
    example_photographs as example_photographs,
    read_image as read_image,
    reading as reading,
)
from .library.pose_stream import NamedFrame as NamedFrame, PoseWatch as PoseWatch
from .library.psf_calibration import calibrate_psf as calibrate_psf
from .library.psf_comparison import (
    PsfComparison as PsfComparison,
    PsfHistory as PsfHistory,
    compare_psfs as compare_psfs,
    psf_history as psf_history,
)
from .library.registration import (
    AlignmentHints as AlignmentHints,
    alignment_hints as alignment_hints,
    register as register,
)
from .library.series import (
    JudgedPose as JudgedPose,
    find_changes_of_series as find_changes_of_series,
    judge_pose as judge_pose,
    judge_poses as judge_poses,
)
from .library.sessions import (
    ExportedSession as ExportedSession,
    ImportedPhotographs as ImportedPhotographs,
    VerifiedSession as VerifiedSession,
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
from .library.simulated_photograph import (
    SimulatedPhotograph as SimulatedPhotograph,
    UncertaintyOptions as UncertaintyOptions,
)
from .library.simulation import (
    CaptureOptions as CaptureOptions,
    simulate as simulate,
    simulate_pose as simulate_pose,
    zoom_out as zoom_out,
)
from .library.sr_pairs import (
    SrDatasetSummary as SrDatasetSummary,
    SweepOptions as SweepOptions,
    training_pairs as training_pairs,
)
from .library.study import plan_study as plan_study, write_study as write_study
from .library.validation import (
    WrittenReport as WrittenReport,
    validate as validate,
    write_report as write_report,
)

__version__: str
__all__: list[str]
