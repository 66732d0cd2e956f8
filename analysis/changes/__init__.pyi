from .filter import (
    FALSE_ALARMS as FALSE_ALARMS,
    ChangeResult as ChangeResult,
    FloatArray as FloatArray,
    find_changes as find_changes,
    significance_threshold as significance_threshold,
)

__all__ = [
    "FALSE_ALARMS",
    "ChangeResult",
    "FloatArray",
    "find_changes",
    "significance_threshold",
]
