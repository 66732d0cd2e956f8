"""Scatter of values beyond their own errors."""

import numpy as np

from simulation.arrays import FloatArray


def excess_variance(
    deviation: FloatArray, err: FloatArray, trust: FloatArray, freedom: float
) -> float:
    """Excess variance, beyond the errors, that brings the weighted squares to their expected value.

    Paule and Mandel, "Consensus values and weighting factors", J. Res. NBS 87 (1982) 377.
    """
    squares = trust * deviation**2
    variance = 0.0
    while True:
        weight = 1.0 / (err**2 + variance)
        surplus = float(np.sum(squares * weight)) - freedom
        if surplus <= 0:
            return variance
        # Newton's steps on a convex curve that falls: all of them are upwards, but for rounding.
        step = surplus / float(np.sum(squares * weight**2))
        variance += step
        if step <= 1e-12 * variance:
            return variance
