from .artefact import ArtefactTiles as ArtefactTiles
from .compared import (
    ComparedChange as ComparedChange,
    compared_change as compared_change,
    comparison_d_prime as comparison_d_prime,
    expected_limits as expected_limits,
    scene_residual as scene_residual,
)
from .covariance import WindowCovariance as WindowCovariance
from .curves import (
    AmbiguousCurveError as AmbiguousCurveError,
    CurveChoice as CurveChoice,
    DetectabilityCurve as DetectabilityCurve,
    DetectabilityCurves as DetectabilityCurves,
    read_curves as read_curves,
)
from .dprime import (
    d_prime_between as d_prime_between,
    d_primes as d_primes,
    scene_artefact as scene_artefact,
)
from .error_sources import (
    NORMAL_95 as NORMAL_95,
    SOURCE_WORDS as SOURCE_WORDS,
    STATED as STATED,
    BudgetShare as BudgetShare,
    CurveUncertainty as CurveUncertainty,
    DPrimeErrors as DPrimeErrors,
    ErrorSources as ErrorSources,
    Source as Source,
    focus_spread as focus_spread,
    student_factor as student_factor,
)
from .local import LocalChange as LocalChange, local_changes as local_changes
from .observers import (
    auc_of as auc_of,
    d_prime_of_auc as d_prime_of_auc,
    observer_templates as observer_templates,
)
from .pair import compared_pair as compared_pair
from .plot import (
    MODEL_COLOURS as MODEL_COLOURS,
    curves_figure as curves_figure,
    draw_curve as draw_curve,
)
from .scenario import Scenario as Scenario
from .sensitivity import (
    MOST_SCENES as MOST_SCENES,
    DPrimeSlopes as DPrimeSlopes,
    capture_response as capture_response,
    response_scenes as response_scenes,
)
from .signal import (
    ChangeSignal as ChangeSignal,
    GaussianSignal as GaussianSignal,
    PatchSignal as PatchSignal,
)
from .sums import ArtefactSums as ArtefactSums
from .sweep import (
    ArtefactWork as ArtefactWork,
    MeasuredPhotograph as MeasuredPhotograph,
    SceneImage as SceneImage,
    SweepPlan as SweepPlan,
    SweepSums as SweepSums,
    scene_sums as scene_sums,
    tiles_per_side as tiles_per_side,
)
from .task import (
    DetectionTask as DetectionTask,
    curves_of as curves_of,
    d_prime_curves as d_prime_curves,
)
