"""Requirements that an alignment must meet to be accepted."""

import numpy as np

from calibration.errors import RegistrationError
from simulation.arrays import BoolArray
from simulation.resampling import ZOOM_MIN

OVERLAP_MIN_PX = 16
"""Follow-up pixels needed along each axis."""

_CORRELATION_MIN = 0.5


def refuse_nearer(zoom: float) -> None:
    """Raise a RegistrationError for a follow-up that is nearer than its reference."""
    if zoom < ZOOM_MIN:
        raise RegistrationError(
            f"the follow-up is nearer than the reference (zoom {zoom:.3f}); swap the two: the "
            "nearer one is the reference",
            reason="nearer",
        )


def refuse_little_overlap(inside: BoolArray) -> None:
    """Raise a RegistrationError if too few of a follow-up's pixels are inside the reference."""
    if np.count_nonzero(inside) < OVERLAP_MIN_PX**2:
        raise RegistrationError("the images overlap too little", reason="little_overlap")


def refuse_negative(gain: float) -> None:
    """Raise a RegistrationError for a follow-up that is dark where it should be bright."""
    if gain <= 0:
        raise RegistrationError("the follow-up does not look like the reference", reason="unlike")


def refuse_low_correlation(correlation: float) -> None:
    """Raise a RegistrationError for images that do not agree once aligned."""
    if not correlation >= _CORRELATION_MIN:
        raise RegistrationError(
            f"the correlation of the aligned images is only {correlation:.2f}, "
            f"{_CORRELATION_MIN} is needed",
            reason="low_correlation",
            correlation=correlation,
        )
