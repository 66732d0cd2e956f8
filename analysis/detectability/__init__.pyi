from .artefact import ArtefactTiles as ArtefactTiles
from .covariance import WindowCovariance as WindowCovariance
from .curves import (
    AmbiguousCurveError as AmbiguousCurveError,
    CurveChoice as CurveChoice,
    CurvesFile as CurvesFile,
    DetectabilityCurve as DetectabilityCurve,
    d_prime_between as d_prime_between,
    read_curves as read_curves,
)
from .dprime import (
    Scenario as Scenario,
    d_prime_curves as d_prime_curves,
    d_primes as d_primes,
    scene_artefact as scene_artefact,
)
from .local import (
    WINDOW_PX as WINDOW_PX,
    LocalChange as LocalChange,
    local_changes as local_changes,
)
from .observers import (
    OBSERVERS as OBSERVERS,
    Observer as Observer,
    observer_templates as observer_templates,
)
from .pair import REFERENCE_ZOOM as REFERENCE_ZOOM, compared_pair as compared_pair
from .signal import (
    ChangeSignal as ChangeSignal,
    GaussianSignal as GaussianSignal,
    PatchSignal as PatchSignal,
)
from .sweep import (
    SceneStatistics as SceneStatistics,
    SweepPlan as SweepPlan,
    sweep_images as sweep_images,
    tiles_per_side as tiles_per_side,
)

__all__ = [
    "OBSERVERS",
    "REFERENCE_ZOOM",
    "WINDOW_PX",
    "AmbiguousCurveError",
    "ArtefactTiles",
    "ChangeSignal",
    "CurveChoice",
    "CurvesFile",
    "DetectabilityCurve",
    "GaussianSignal",
    "LocalChange",
    "Observer",
    "PatchSignal",
    "Scenario",
    "SceneStatistics",
    "SweepPlan",
    "WindowCovariance",
    "compared_pair",
    "d_prime_between",
    "d_prime_curves",
    "d_primes",
    "local_changes",
    "observer_templates",
    "read_curves",
    "scene_artefact",
    "sweep_images",
    "tiles_per_side",
]
