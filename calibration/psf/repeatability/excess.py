"""Scatter of values beyond their own errors."""

import numpy as np
from scipy.optimize import brentq

from simulation.arrays import FloatArray


def excess_variance(
    deviation: FloatArray, err: FloatArray, trust: FloatArray, freedom: float
) -> float:
    """Excess variance, beyond the errors, that brings the weighted squares to their expected value.

    Paule and Mandel, "Consensus values and weighting factors", J. Res. NBS 87 (1982) 377.
    """

    def surplus(variance: float) -> float:
        return float(np.sum(trust * deviation**2 / (err**2 + variance))) - freedom

    if surplus(0.0) <= 0:
        return 0.0
    most = float(np.sum(trust * deviation**2)) / freedom
    return float(brentq(surplus, 0.0, most, xtol=1e-12 * most))
