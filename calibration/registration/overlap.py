"""Which pixels of a follow-up its reference covers."""

from dataclasses import dataclass
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from calibration.errors import RegistrationError
from simulation import SamplingGrid
from simulation.resampling import ZOOM_MIN

__all__ = [
    "OVERLAP_MIN_PX",
    "Overlap",
    "axial_overlap",
    "refuse_little_overlap",
    "refuse_low_correlation",
    "refuse_nearer",
    "refuse_negative",
]

FloatArray = NDArray[np.float64]

OVERLAP_MIN_PX = 16
"""Follow-up pixels needed along each axis."""

_CORRELATION_MIN = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Overlap:
    """The follow-up pixels that lie wholly inside the reference.

    Parameters
    ----------
    grid
        Their places in the reference, for ``zoom_out_on_grid``.
    rows, cols
        Their places in the follow-up: ``followup[overlap.rows, overlap.cols]``.
    """

    grid: SamplingGrid
    rows: slice
    cols: slice


def axial_overlap(
    matrix: FloatArray, reference_shape: tuple[int, int], followup_shape: tuple[int, int]
) -> Overlap:
    """Overlap of a follow-up with its reference.

    Parameters
    ----------
    matrix
        Shape (3, 3): a zoom and a shift, follow-up pixel centres to reference pixel centres.
    reference_shape, followup_shape
        ``(rows, cols)``.

    Raises
    ------
    RegistrationError
        If the follow-up is nearer than the reference or the overlap is too small.
    """
    zoom = float(matrix[0, 0])
    refuse_nearer(zoom)
    spans = []
    for origin_px, size, count in (
        (float(matrix[1, 2]), reference_shape[0], followup_shape[0]),
        (float(matrix[0, 2]), reference_shape[1], followup_shape[1]),
    ):
        # A follow-up pixel is a square of side `zoom`; the reference ends half a pixel outside
        # its outermost centres.
        first = max(ceil(((zoom - 1) / 2 - origin_px) / zoom - 1e-9), 0)
        last = min(floor((size - 1 - (zoom - 1) / 2 - origin_px) / zoom + 1e-9), count - 1)
        if last - first + 1 < OVERLAP_MIN_PX:
            raise RegistrationError("the images overlap too little", reason="little_overlap")
        spans.append((first, last + 1, origin_px + first * zoom))
    (top, bottom, origin_y_px), (left, right, origin_x_px) = spans
    grid = SamplingGrid(
        zoom_y=zoom,
        zoom_x=zoom,
        origin_y_px=origin_y_px,
        origin_x_px=origin_x_px,
        rows=bottom - top,
        cols=right - left,
    )
    return Overlap(grid=grid, rows=slice(top, bottom), cols=slice(left, right))


def refuse_nearer(zoom: float) -> None:
    """Raise a RegistrationError for a follow-up that is nearer than its reference."""
    if zoom < ZOOM_MIN:
        raise RegistrationError(
            f"the follow-up is nearer than the reference (zoom {zoom:.3f}); swap the two, as the "
            "nearer one is the reference",
            reason="nearer",
        )


def refuse_little_overlap(inside: NDArray[np.bool_]) -> None:
    """Raise a RegistrationError where too few of a follow-up's pixels lie in the reference."""
    if np.count_nonzero(inside) < OVERLAP_MIN_PX**2:
        raise RegistrationError("the images overlap too little", reason="little_overlap")


def refuse_negative(gain: float) -> None:
    """Raise a RegistrationError for a follow-up that is dark where it should be bright."""
    if gain <= 0:
        raise RegistrationError("the follow-up does not look like the reference", reason="unlike")


def refuse_low_correlation(correlation: float) -> None:
    """Raise a RegistrationError for images that do not agree where they are aligned."""
    if not correlation >= _CORRELATION_MIN:
        raise RegistrationError(
            f"the aligned images correlate by {correlation:.2f} only, {_CORRELATION_MIN} is needed",
            reason="low_correlation",
            correlation=correlation,
        )
