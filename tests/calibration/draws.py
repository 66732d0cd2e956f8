"""How far errors in units of their stated standard errors scatter by chance."""

import numpy as np
from scipy.stats import chi2


def rms_range(independent: int) -> tuple[float, float]:
    """What the RMS of so many unit normals is within 999 times of 1000.

    Where numbers hang together, ``independent`` is how many of them do not, or less.
    """
    low, high = np.sqrt(chi2.ppf([0.0005, 0.9995], independent) / independent)
    return float(low), float(high)
