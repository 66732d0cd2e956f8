from ._artefact import (
    ArtefactTiles as ArtefactTiles,
    WindowCovariance as WindowCovariance,
    auc_of as auc_of,
    d_prime_of_auc as d_prime_of_auc,
    observer_templates as observer_templates,
)
from ._compared import (
    ComparedChange as ComparedChange,
    compared_change as compared_change,
    comparison_d_prime as comparison_d_prime,
    expected_limits as expected_limits,
    scene_residual as scene_residual,
)
from ._curves import (
    SOURCE_WORDS as SOURCE_WORDS,
    STATED as STATED,
    AmbiguousCurveError as AmbiguousCurveError,
    BudgetShare as BudgetShare,
    CurveChoice as CurveChoice,
    CurveUncertainty as CurveUncertainty,
    DetectabilityCurve as DetectabilityCurve,
    DetectabilityCurves as DetectabilityCurves,
    DPrimeErrors as DPrimeErrors,
    ErrorSources as ErrorSources,
    Source as Source,
    focus_spread as focus_spread,
    read_curves as read_curves,
)
from ._dprime import (
    MOST_SCENES as MOST_SCENES,
    DPrimeSlopes as DPrimeSlopes,
    capture_response as capture_response,
    d_prime_between as d_prime_between,
    d_primes as d_primes,
    response_scenes as response_scenes,
    scene_artefact as scene_artefact,
    student_factor as student_factor,
)
from ._plot import (
    MODEL_COLOURS as MODEL_COLOURS,
    curves_figure as curves_figure,
    draw_curve as draw_curve,
)
from ._scenario import (
    ChangeSignal as ChangeSignal,
    GaussianSignal as GaussianSignal,
    LocalChange as LocalChange,
    PatchSignal as PatchSignal,
    Scenario as Scenario,
    compared_pair as compared_pair,
    local_changes as local_changes,
)
from ._sweep import (
    ArtefactSums as ArtefactSums,
    ArtefactWork as ArtefactWork,
    MeasuredPhotograph as MeasuredPhotograph,
    SceneImage as SceneImage,
    SweepPlan as SweepPlan,
    SweepSums as SweepSums,
    scene_sums as scene_sums,
    tiles_per_side as tiles_per_side,
)
from ._task import (
    DetectionTask as DetectionTask,
    curves_of as curves_of,
    curves_of_images as curves_of_images,
)
