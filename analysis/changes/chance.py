"""How many pixels and how many peaks of a frame without change exceed a significance."""

from math import pi

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from simulation.arrays import FloatArray

_SPREAD_ERR = 0.03
"""Relative standard deviation, over the frame, of the true spread about the one worked out: what
the calibration of the variance and the neighbours' correlation leave open."""

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(15)
_SPREADS, _SHARES = 1 + _SPREAD_ERR * _NODES, _WEIGHTS / _WEIGHTS.sum()

_LATTICE_NODES, _LATTICE_WEIGHTS = np.polynomial.legendre.leggauss(4)
_OFF_PX2 = np.add.outer(_LATTICE_NODES**2, _LATTICE_NODES**2).ravel() / 4
_OFF_SHARES = np.multiply.outer(_LATTICE_WEIGHTS, _LATTICE_WEIGHTS).ravel() / 4
"""Squared distances of a peak from its nearest pixel, and their shares."""


def significance_threshold(rate: float) -> float:
    """Standard deviations that a pixel without change exceeds, either way, at this rate."""

    def excess(threshold: float) -> float:
        return float(np.log(np.sum(_SHARES * 2 * ndtr(-threshold / _SPREADS)) / rate))

    if rate >= 1:
        return 0.0
    return float(brentq(excess, 0.0, 30.0))


def expected_peaks(significance: FloatArray, area_px: int, smoothing_px: float) -> FloatArray:
    """How many peaks of either sign chance lifts beyond a significance, in a frame.

    The expected Euler characteristic of the set beyond it, which at 3 standard deviations and more
    is the number of its peaks; each is seen in the pixel nearest to it, and so a little lower.

    Parameters
    ----------
    significance
        Standard deviations, any shape.
    area_px
        Pixels that were compared.
    smoothing_px
        Width of the Gaussian behind which the noise was white: neighbours have the correlation
        ``exp(-d^2 / (4 smoothing_px^2))``.

    References
    ----------
    R. J. Adler, The Geometry of Random Fields (1981), theorem 5.3.1; with the mean curvature of a
    high peak, as in theorem 6.8.1, for what its pixel misses.
    """
    lowered = np.exp(-_OFF_PX2 / (4 * smoothing_px**2))
    height = np.asarray(significance)[..., None, None] / (_SPREADS[:, None] * lowered)
    density = height * np.exp(-(height**2) / 2) / ((2 * pi) ** 1.5 * 2 * smoothing_px**2)
    return np.asarray(2 * area_px * np.einsum("...ij,i,j->...", density, _SHARES, _OFF_SHARES))
