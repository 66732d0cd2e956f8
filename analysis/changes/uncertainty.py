"""How uncertain a difference image is at each pixel: noise, registration and model.

The three have their own shapes: what the noise model says, the squared gradient (a shift by
``e`` px makes ``e |gradient|``) and the squared Laplacian (a width that is wrong by ``t`` px^2
makes ``t / 2`` times it). Their sizes are fitted to the difference itself, most of which holds no
change.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion, convolve, laplace
from scipy.optimize import nnls

from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, FloatArray

_BLOCK_PX = 16
"""Pixels of other blocks are taken as independent."""

_OUTLIER = 6.0
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


def extra_blur(expected_dn: FloatArray, followup_dn: FloatArray, valid: BoolArray) -> ExtraBlur:
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
    scale = robust_sigma(difference[inner]) + 1e-9
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


_ROUNDS = 6
_CLIP = 3.5
"""Standard deviations beyond which a pixel does not count; 0.05 % of normal ones."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DifferenceVariance:
    """Variance of a difference image and what it is made of.

    Parameters
    ----------
    variance_dn2
        Shape ``(rows, cols)``.
    noise_factor
        Fitted noise variance over that of the noise model, at least 1; over 1 DN^2 where no
        noise model was given.
    registration_err_px
        Standard deviation of the registration along the gradient.
    width_err_px2
        Standard deviation of the variance by which the simulated blur is wrong.
    """

    variance_dn2: FloatArray
    noise_factor: float
    registration_err_px: float
    width_err_px2: float


def fit_variance(
    difference_dn: FloatArray,
    simulated_dn: FloatArray,
    valid: BoolArray,
    noise_variance_dn2: FloatArray | None,
) -> DifferenceVariance:
    """Fit the sizes of noise, registration and model error to a difference image.

    Parameters
    ----------
    difference_dn, simulated_dn
        Follow-up minus simulation, and the simulation; shape ``(rows, cols)``.
    valid
        Pixels to be used, same shape.
    noise_variance_dn2
        What the noise model says, same shape; None if it is not known.
    """
    noise = np.ones_like(difference_dn) if noise_variance_dn2 is None else noise_variance_dn2
    along_y, along_x = np.gradient(simulated_dn)
    shapes = np.stack([noise, (along_y**2 + along_x**2) / 2, laplace(simulated_dn) ** 2 / 4])
    used, squares = shapes[:, valid], difference_dn[valid] ** 2
    floor = 0.0 if noise_variance_dn2 is None else 1.0
    spread = float(np.median(squares)) / 0.4549  # median of chi-squared, one degree of freedom
    expected = np.full(len(squares), max(spread, 1e-12))
    sizes = np.zeros(3)
    for _ in range(_ROUNDS):
        counts = squares < _CLIP**2 * expected
        # A square has the variance 2 expected^2.
        weight = 1.0 / expected[counts]
        sizes, _ = nnls((used[:, counts] * weight).T, squares[counts] * weight)
        sizes[0] = max(sizes[0], floor)
        expected = np.maximum(sizes @ used, 1e-12)
    return DifferenceVariance(
        variance_dn2=np.maximum(np.tensordot(sizes, shapes, axes=1), 1e-12),
        noise_factor=float(sizes[0]),
        registration_err_px=float(np.sqrt(sizes[1])),
        width_err_px2=float(np.sqrt(sizes[2])),
    )
