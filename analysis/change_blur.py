"""How much softer a follow-up is than simulated: defocus and motion, told from noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, convolve, laplace

__all__ = ["ExtraBlur", "extra_blur", "immerkaer_variance"]

FloatArray = NDArray[np.float64]

_BLOCK_PX = 16
"""Pixels of other blocks are taken as independent."""

_OUTLIER = 6.0
_NORMAL = 1.4826
"""Standard deviation of normal values over the median of their sizes."""

_NOISE_MASK = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtraBlur:
    """Variance in px^2 by which the follow-up is softer, and its standard error.

    Without any detail the error is infinite and the value 0.
    """

    value_px2: float
    err_px2: float


def extra_blur(
    expected_dn: FloatArray,
    followup_dn: FloatArray,
    valid: NDArray[np.bool_],
    followup_noise_dn2: float,
) -> ExtraBlur:
    """Fit the variance t of a blur: what it changes is ``t / 2`` times the Laplacian.

    The difference is correlated with the Laplacian of the *follow-up*, whose noise is white and
    adds ``-2`` times its variance; the noise of the simulated image, which is not white, drops
    out. Against the Laplacian of the simulated image it would pass for blur.

    Parameters
    ----------
    expected_dn, followup_dn
        The simulated follow-up in the follow-up's light, and the real one, shape ``(rows, cols)``.
    valid
        Pixels that count.
    followup_noise_dn2
        Mean variance of the follow-up's noise.
    """
    inner = binary_erosion(valid)
    if not inner.any():
        return ExtraBlur(value_px2=0.0, err_px2=np.inf)
    difference = followup_dn - expected_dn
    scale = _NORMAL * float(np.median(np.abs(difference[inner]))) + 1e-9
    kept = inner & (np.abs(difference) < _OUTLIER * scale)
    curved, seen_curved = laplace(expected_dn) / 2, laplace(followup_dn) / 2
    moved = _block_sums(kept * (difference * seen_curved + 2 * followup_noise_dn2))
    power = _block_sums(kept * (curved * seen_curved))
    if not power.sum() > 0:
        return ExtraBlur(value_px2=0.0, err_px2=np.inf)
    value = float(moved.sum() / power.sum())
    err = float(np.sqrt(np.sum((moved - value * power) ** 2)) / power.sum())
    return ExtraBlur(value_px2=value, err_px2=err)


def immerkaer_variance(image_dn: FloatArray, valid: NDArray[np.bool_]) -> float:
    """Variance of white noise on an image that is otherwise smooth, whatever its outliers.

    References
    ----------
    J. Immerkaer, "Fast noise variance estimation", 1996; by the median instead of the mean.
    """
    inner = binary_erosion(valid, np.ones((3, 3), dtype=np.bool_))
    if not inner.any():
        return 0.0
    rough = convolve(image_dn, _NOISE_MASK)[inner]
    return float((_NORMAL * np.median(np.abs(rough))) ** 2 / np.sum(_NOISE_MASK**2))


def _block_sums(values: FloatArray) -> FloatArray:
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], _BLOCK_PX), axis=0)
    return np.asarray(np.add.reduceat(rows, np.arange(0, values.shape[1], _BLOCK_PX), axis=1))
