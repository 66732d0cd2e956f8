"""How likely a spot is found, and the amplitude at which it is found as often as asked."""

import numpy as np
from scipy.optimize import brentq
from scipy.stats import ncx2

from analysis.changes.detection.chance import FilterWidth
from analysis.changes.detection.joint_significance import PLANES, norm_at
from simulation.arrays import FloatArray

POWER = 0.95
"""Of a detection limit."""

_SEARCHED = 1.0
"""Degrees of freedom of the search for the highest significance, beside a spot's own noise.

In white noise it is 2 to 2.5, two for the place and the rest for the width; what the fit between
photographs takes of each spot is worth one.
"""

_OFF_PX2 = 1 / 6
"""Mean squared distance of a spot from the nearest pixel's centre."""


def detection_power(height: FloatArray, threshold_sd: float, planes: int = 1) -> FloatArray:
    """Probability that a spot is found.

    Its significance is searched over places and widths: the square of the highest one is that of
    ``height`` and its own noise, and chi-squared for what the search adds.

    Parameters
    ----------
    height
        Significance that the spot has by itself at its place, any shape.
    threshold_sd
        Significance beyond which a place counts as changed.
    planes
        1 for levels, 3 for colours, of which the noise of all adds.
    """
    if planes == PLANES:
        beyond = float(norm_at(threshold_sd)) ** 2
        return np.asarray(ncx2.sf(beyond, PLANES + _SEARCHED, np.square(height)))
    return np.asarray(ncx2.sf(threshold_sd**2, 1 + _SEARCHED, np.square(height)))


def height_for(power: float, threshold_sd: float, planes: int = 1) -> float:
    """Significance that a spot must have by itself to be found with this probability."""

    def excess(height: float) -> float:
        return float(detection_power(np.array(height), threshold_sd, planes)) - power

    return float(brentq(excess, 0.0, threshold_sd + 20.0))


def response(spot_sigma_px: FloatArray, width: FilterWidth) -> FloatArray:
    """Peak that a spot of peak 1 has behind a filter, at the sample nearest to it.

    Parameters
    ----------
    spot_sigma_px
        Of the spot before the filter, in the grid's pixels, any shape.
    width
        Of the filter.
    """
    own = np.square(spot_sigma_px)
    wide = own + width.width_px**2
    return np.asarray(own / wide * np.exp(-_OFF_PX2 * width.step_px**2 / (2 * wide)))
