from ._quality import (
    QualityFinding as QualityFinding,
    check_capture as check_capture,
)
from ._runner import (
    CaptureProgress as CaptureProgress,
    Placement as Placement,
    PlanPreview as PlanPreview,
    RunOperator as RunOperator,
    RunSummary as RunSummary,
    Verdict as Verdict,
    flicker_warnings as flicker_warnings,
    run_plan as run_plan,
)
from ._step import (
    EXPOSURE_AIM as EXPOSURE_AIM,
    SHORTEST_EXPOSURE_US as SHORTEST_EXPOSURE_US,
    CaptureStep as CaptureStep,
    ExposureLimit as ExposureLimit,
    FoundExposure as FoundExposure,
    find_exposure as find_exposure,
)
