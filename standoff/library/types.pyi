__all__: list[str]

from acquisition.aravis import (
    FoundCamera as FoundCamera,
)
from acquisition.bench import (
    BenchConfig as BenchConfig,
    BenchDevices as BenchDevices,
)
from acquisition.capture import (
    CaptureProgress as CaptureProgress,
    PlanPreview as PlanPreview,
    QualityFinding as QualityFinding,
)
from acquisition.devices import (
    Camera as Camera,
    Stage as Stage,
)
from acquisition.focus import (
    FocusPeak as FocusPeak,
    FocusPoint as FocusPoint,
    FocusReading as FocusReading,
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
from analysis.benchmark import (
    BenchmarkScores as BenchmarkScores,
    read_scores as read_scores,
)
from analysis.change_series import (
    ChangesSeries as ChangesSeries,
    ChangeTimeLine as ChangeTimeLine,
    ComparedFollowup as ComparedFollowup,
    read_changes_series as read_changes_series,
    read_time_line as read_time_line,
)
from analysis.changes import (
    ChangeSummary as ChangeSummary,
    read_changes as read_changes,
)
from analysis.detectability import (
    ChangeSignal as ChangeSignal,
    DetectabilityCurve as DetectabilityCurve,
    DetectabilityCurves as DetectabilityCurves,
    ErrorSources as ErrorSources,
    SweepPlan as SweepPlan,
    read_curves as read_curves,
)
from analysis.detectors import (
    Detector as Detector,
)
from analysis.detectors.learned import (
    LearnedDetector as LearnedDetector,
    TrainingPair as TrainingPair,
    load_learned as load_learned,
)
from analysis.evaluation import (
    Condition as Condition,
    Evaluation as Evaluation,
    PaintedChange as PaintedChange,
    Patch as Patch,
    read_evaluation as read_evaluation,
)
from analysis.evaluation.change_pairs import (
    ChangePairsDataset as ChangePairsDataset,
)
from analysis.followup_series import (
    SeriesResult as SeriesResult,
)
from analysis.pose import (
    JudgedFollowup as JudgedFollowup,
    PoseSeries as PoseSeries,
    PoseSummary as PoseSummary,
    PoseVerdict as PoseVerdict,
    StreamSummary as StreamSummary,
    read_pose as read_pose,
    read_pose_series as read_pose_series,
)
from analysis.sr_dataset import (
    SrDatasetSummary as SrDatasetSummary,
)
from analysis.study import (
    PlanStudy as PlanStudy,
    read_study as read_study,
)
from analysis.validation import (
    Validation as Validation,
    read_validation as read_validation,
)
from calibration.edges import EdgeMeasurement as EdgeMeasurement, Region as Region
from calibration.files import (
    read_correction as read_correction,
    read_geometry as read_geometry,
    read_homography as read_homography,
    read_noise as read_noise,
    read_psf as read_psf,
    write_homography as write_homography,
)
from calibration.geometry import (
    CharucoBoard as CharucoBoard,
    GeometryCalibration as GeometryCalibration,
)
from calibration.noise import (
    CorrectionMaps as CorrectionMaps,
    NoiseCalibration as NoiseCalibration,
    NoiseMeasurement as NoiseMeasurement,
)
from calibration.psf import PsfCalibration as PsfCalibration
from calibration.registration import Homography as Homography, Registration as Registration
from hil_mocks import (
    SimulatedBench as SimulatedBench,
)
from simulation.capture_noise import (
    CaptureNoise as CaptureNoise,
)
from simulation.pose import (
    SimulatedPose as SimulatedPose,
)
from simulation.psf import (
    MeasuredPsf as MeasuredPsf,
    Psf as Psf,
    SeparablePsf as SeparablePsf,
)
from standoff.library import (
    NamedFrame as NamedFrame,
)
from standoff.library.bench import (
    CapturedSession as CapturedSession,
    FoundFocus as FoundFocus,
    WatchedFocus as WatchedFocus,
)
from standoff.library.bench_capture import (
    BenchCapture as BenchCapture,
)
from standoff.library.benchmark import (
    MadeBenchmark as MadeBenchmark,
    ScoredBenchmark as ScoredBenchmark,
)
from standoff.library.comparison import (
    AlignmentHints as AlignmentHints,
    ComparedPhotographs as ComparedPhotographs,
)
from standoff.library.detectability import (
    AllowedMovement as AllowedMovement,
    JudgedHomography as JudgedHomography,
    MeasuredCurves as MeasuredCurves,
)
from standoff.library.evaluation import (
    ChangePairs as ChangePairs,
    EvaluatedDetector as EvaluatedDetector,
)
from standoff.library.example_photographs import (
    ExamplePhotographs as ExamplePhotographs,
)
from standoff.library.followup import (
    SimulatedPhotograph as SimulatedPhotograph,
)
from standoff.library.psf import (
    PsfComparison as PsfComparison,
    PsfHistory as PsfHistory,
)
from standoff.library.series import (
    JudgedPose as JudgedPose,
)
from standoff.library.sessions import (
    ExportedSession as ExportedSession,
    ImportedPhotographs as ImportedPhotographs,
    VerifiedSession as VerifiedSession,
    WrittenReport as WrittenReport,
)
from standoff.photographs import (
    Photograph as Photograph,
    ReadOptions as ReadOptions,
)
