from ._live import (
    FocusMeter as FocusMeter,
    FocusOptions as FocusOptions,
    FocusPoint as FocusPoint,
    FocusReading as FocusReading,
    FocusTrace as FocusTrace,
    focus_values as focus_values,
    newest_frames as newest_frames,
)
from ._measures import (
    FOCUS_MEASURES as FOCUS_MEASURES,
    Region as Region,
    focus_value as focus_value,
    has_detail as has_detail,
    shows_nothing as shows_nothing,
    texture_share as texture_share,
)
from ._sweep import (
    UNKNOWN_PUPIL as UNKNOWN_PUPIL,
    FocusPeak as FocusPeak,
    FocusSweep as FocusSweep,
    NoFocusPeakError as NoFocusPeakError,
    PupilOffset as PupilOffset,
    SweepRequest as SweepRequest,
    fit_focus_peak as fit_focus_peak,
    light_fault as light_fault,
    pooled_errs as pooled_errs,
    positions_of as positions_of,
    sweep_bench as sweep_bench,
)
