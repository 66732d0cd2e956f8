from .detail import has_detail as has_detail, shows_nothing as shows_nothing
from .live import (
    FocusMeter as FocusMeter,
    FocusOptions as FocusOptions,
    FocusPoint as FocusPoint,
    LiveFocus as LiveFocus,
    focus_values as focus_values,
    newest_frames as newest_frames,
    sweep_focus as sweep_focus,
)
from .measures import FOCUS_MEASURES as FOCUS_MEASURES, Region as Region, focus_value as focus_value
from .search import (
    FocusSweep as FocusSweep,
    SweepRequest as SweepRequest,
    light_fault as light_fault,
    pooled_errs as pooled_errs,
    positions_of as positions_of,
    sweep_bench as sweep_bench,
)
from .sweep import (
    UNKNOWN_PUPIL as UNKNOWN_PUPIL,
    FocusPeak as FocusPeak,
    NoFocusPeakError as NoFocusPeakError,
    PupilOffset as PupilOffset,
    fit_focus_peak as fit_focus_peak,
)
from .texture import texture_share as texture_share
from .trace import FocusReading as FocusReading, FocusTrace as FocusTrace
