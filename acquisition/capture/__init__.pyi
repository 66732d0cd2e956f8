from .auto_exposure import flicker_fraction as flicker_fraction, without_flicker as without_flicker
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

__all__ = [
    "CaptureProgress",
    "CaptureStep",
    "Placement",
    "QualityFinding",
    "RunOperator",
    "RunSummary",
    "Verdict",
    "check_capture",
    "flicker_fraction",
    "run_plan",
    "without_flicker",
]
