"""Scatter that a few outliers do not move."""

import numpy as np

from simulation.arrays import FloatImage
from simulation.compiled import compiled_part

_MAD_PER_SIGMA = 0.6744897501960817  # median absolute deviation of a unit normal


@compiled_part()
def robust_sigma(deviations: FloatImage) -> float:
    """Standard deviation of Gaussian deviations about 0, from the median of their moduli.

    Python and compiled code both call it. Up to half of the values may be outliers; the variance of
    Gaussian ones is known as well as from 0.368 times as many without them.
    """
    return float(np.median(np.abs(deviations)) / _MAD_PER_SIGMA)
