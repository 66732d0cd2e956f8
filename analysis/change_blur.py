"""How much softer a follow-up is than simulated: defocus and motion, told from noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, convolve, laplace

__all__ = ["ExtraBlur", "extra_blur"]

FloatArray = NDArray[np.float64]

_BLOCK_PX = 16
"""Pixels of other blocks are taken as independent."""

_OUTLIER = 6.0
_NORMAL = 1.4826
"""Standard deviation of normal values over the median of their sizes."""

_AROUND = np.zeros((5, 5))
_AROUND[[0, 2, 2, 4], [2, 0, 4, 2]] = 0.25
_AROUND[[1, 2, 2, 3], [2, 1, 3, 2]] = -0.25
"""Curvature without the pixel itself: mean of the four pixels 2 px away less those 1 px away."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtraBlur:
    """Variance in px^2 by which the follow-up is softer, and its standard error.

    Without any detail the error is infinite and the value 0.
    """

    value_px2: float
    err_px2: float


def extra_blur(
    expected_dn: FloatArray, followup_dn: FloatArray, valid: NDArray[np.bool_]
) -> ExtraBlur:
    """Fit the variance t of a blur: what it changes is ``t / 2`` times the Laplacian.

    The difference and the Laplacian of the simulated image share that image's noise, which would
    pass for blur. So both are held against a third image, the curvature of the *follow-up* around
    each pixel, as an instrumental variable: its noise is in neither, as long as that of one pixel
    tells nothing of the next (raw frames; not demosaiced or compressed ones).

    Parameters
    ----------
    expected_dn, followup_dn
        The simulated follow-up in the follow-up's light, and the real one, shape ``(rows, cols)``.
    valid
        Pixels that count.
    """
    inner = binary_erosion(valid, np.ones((5, 5), dtype=np.bool_))
    if not inner.any():
        return ExtraBlur(value_px2=0.0, err_px2=np.inf)
    difference = followup_dn - expected_dn
    scale = _NORMAL * float(np.median(np.abs(difference[inner]))) + 1e-9
    kept = inner & (np.abs(difference) < _OUTLIER * scale)
    around = kept * convolve(followup_dn, _AROUND)
    moved = _block_sums(around * difference)
    power = _block_sums(around * laplace(expected_dn) / 2)
    if not power.sum() > 0:
        return ExtraBlur(value_px2=0.0, err_px2=np.inf)
    value = float(moved.sum() / power.sum())
    err = float(np.sqrt(np.sum((moved - value * power) ** 2)) / power.sum())
    return ExtraBlur(value_px2=value, err_px2=err)


def _block_sums(values: FloatArray) -> FloatArray:
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], _BLOCK_PX), axis=0)
    return np.asarray(np.add.reduceat(rows, np.arange(0, values.shape[1], _BLOCK_PX), axis=1))
