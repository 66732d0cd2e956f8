"""How uncertain a difference image is at each pixel: noise, registration and model.

The three have their own shapes: what the noise model says, the squared gradient (a shift by
``e`` px makes ``e |gradient|``) and the squared Laplacian (a width that is wrong by ``t`` px^2
makes ``t / 2`` times it). Their sizes are fitted to the difference itself, most of which holds no
change.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import laplace
from scipy.optimize import nnls

__all__ = ["DifferenceVariance", "fit_variance"]

FloatArray = NDArray[np.float64]

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
    valid: NDArray[np.bool_],
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
