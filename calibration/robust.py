"""Scatter that a few outliers do not move, and the error of a median."""

from math import pi, sqrt

import numpy as np

from simulation.arrays import FloatArray, FloatImage
from simulation.compiled import compiled_part

_MEDIAN_ERR = sqrt(pi / 2)  # standard error of a median over that of a mean, Gaussian scatter
_FEWEST_FOR_SCATTER = 4
_MAD_PER_SIGMA = 0.6744897501960817  # median absolute deviation of a unit normal


@compiled_part()
def robust_sigma(deviations: FloatImage) -> float:
    """Standard deviation of Gaussian deviations about 0, from the median of their moduli.

    Python and compiled code both call it. Up to half of the values may be outliers; the variance of
    Gaussian ones is known as well as from 0.368 times as many without them.
    """
    return float(np.median(np.abs(deviations)) / _MAD_PER_SIGMA)


def median_err(curves: FloatArray, errs: FloatArray) -> FloatArray:
    """Return the standard error of the median of curves: of their noise, or their scatter if more.

    The scatter of few curves is no measure: up to three, noise alone counts.

    Parameters
    ----------
    curves
        Values, shape ``(n, points)``; the median is that over the first axis.
    errs
        Their standard errors, or those of some of them, shape ``(some, points)``.
    """
    count = len(curves)
    share = 1.0 if count < 3 else _MEDIAN_ERR
    noise = share * np.sqrt(np.mean(errs**2, axis=0) / count)
    if count < _FEWEST_FOR_SCATTER:
        return np.asarray(noise)
    away = curves - np.median(curves, axis=0)
    scatter = np.array([robust_sigma(column) for column in away.T])
    return np.asarray(np.maximum(noise, _MEDIAN_ERR * scatter / sqrt(count)))
