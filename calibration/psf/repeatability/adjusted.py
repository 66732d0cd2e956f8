"""Edges as they would be at the mean focus, on a target without softness of its own."""

from collections.abc import Hashable
from math import sqrt

from calibration.edges import EdgeMeasurement

_LEAST_SHARE = 0.01  # of its variance; nothing that is taken off an edge leaves it less


def capture_of(edge: EdgeMeasurement) -> Hashable:
    """What tells the capture of an edge from others: its number, or the name of its image."""
    return edge.image if edge.capture is None else edge.capture


def without_blur(edge: EdgeMeasurement, blur_px2: float) -> EdgeMeasurement:
    """Return the edge with less variance, of the total and the optical width alike.

    The variance stays positive: at least a hundredth of it is left.
    """
    if blur_px2 == 0:
        return edge
    sigma_px, err_px = _narrowed(edge.sigma_px, edge.sigma_err_px, blur_px2)
    optical_px, optical_err_px = edge.optical_sigma_px, edge.optical_sigma_err_px
    if optical_px is not None and optical_err_px is not None:
        if optical_px**2 <= blur_px2:
            optical_px, optical_err_px = None, None
        else:
            optical_px, optical_err_px = _narrowed(optical_px, optical_err_px, blur_px2)
    return edge.model_copy(
        update={
            "sigma_px": sigma_px,
            "sigma_err_px": err_px,
            "optical_sigma_px": optical_px,
            "optical_sigma_err_px": optical_err_px,
        }
    )


def _narrowed(sigma_px: float, err_px: float, blur_px2: float) -> tuple[float, float]:
    """A width and its error: that of the variance stays what it is."""
    narrow_px = sqrt(max(sigma_px**2 - blur_px2, _LEAST_SHARE * sigma_px**2))
    return narrow_px, err_px * sigma_px / narrow_px
