from .auto_exposure import (
    EXPOSURE_AIM as EXPOSURE_AIM,
    SHORTEST_EXPOSURE_US as SHORTEST_EXPOSURE_US,
    ExposureLimit as ExposureLimit,
    FoundExposure as FoundExposure,
    find_exposure as find_exposure,
    flicker_fraction as flicker_fraction,
    without_flicker as without_flicker,
)
from .preview import PlanPreview as PlanPreview, flicker_warnings as flicker_warnings
from .quality import QualityFinding as QualityFinding, check_capture as check_capture
from .runner import (
    CaptureProgress as CaptureProgress,
    Placement as Placement,
    RunOperator as RunOperator,
    RunSummary as RunSummary,
    Verdict as Verdict,
    run_plan as run_plan,
)
from .step import CaptureStep as CaptureStep
