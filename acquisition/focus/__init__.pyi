from .live import (
    FocusMeter as FocusMeter,
    FocusOptions as FocusOptions,
    FocusPoint as FocusPoint,
    focus_values as focus_values,
    newest_frames as newest_frames,
    sweep_focus as sweep_focus,
)
from .measures import FOCUS_MEASURES as FOCUS_MEASURES, Region as Region, focus_value as focus_value
from .sweep import (
    FocusPeak as FocusPeak,
    NoFocusPeakError as NoFocusPeakError,
    fit_focus_peak as fit_focus_peak,
)
from .trace import FocusReading as FocusReading, FocusTrace as FocusTrace

__all__ = [
    "FOCUS_MEASURES",
    "FocusMeter",
    "FocusOptions",
    "FocusPeak",
    "FocusPoint",
    "FocusReading",
    "FocusTrace",
    "NoFocusPeakError",
    "Region",
    "fit_focus_peak",
    "focus_value",
    "focus_values",
    "newest_frames",
    "sweep_focus",
]
