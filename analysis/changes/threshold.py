"""The threshold that a stated rate of false alarms needs."""

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

_SPREAD_ERR = 0.03
"""Relative standard deviation, over the frame, of the true spread about the one worked out: what
the calibration of the variance and the neighbours' correlation leave open."""


def significance_threshold(rate: float) -> float:
    """Standard deviations that a pixel without change exceeds, either way, at this rate."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(15)
    spreads, weights = 1 + _SPREAD_ERR * nodes, weights / weights.sum()

    def excess(threshold: float) -> float:
        return float(np.log(np.sum(weights * 2 * ndtr(-threshold / spreads)) / rate))

    if rate >= 1:
        return 0.0
    return float(brentq(excess, 0.0, 30.0))
