"""Clipped pixels of an edge: what their levels still tell, and how much of the edge is left.

At the saturation level a pixel is at least that bright, at black at most that dark. Least squares
take the level of a clipped pixel for its own and find the edge too narrow: by 0.6 to 3 % where a
third of the pixels is clipped. Their likelihood has no such bias, and its error grows with what is
not seen.
"""

from typing import NamedTuple

import numpy as np

from calibration.edge_fit.level_steps import LevelSteps
from calibration.edge_fit.residuals import cut_variance
from simulation.arrays import BoolArray, FloatArray
from simulation.compiled import compiled_part

NEARLY_SATURATED = 0.995  # of the saturation level
_BLACK_DN = 0.0
_CENSORED_FROM = 0.005  # of the pixels: fewer move sigma by less than a tenth of its error
_FINE_STEP = 0.1  # of the noise: an interval as narrow is as good as a level
_LEAST_STEP = 1e-3  # of the contrast, where there is no noise
_USUAL_NOISE = 0.3  # of a step, before rounding, where rounding matters
_UNBOUNDED = 1e6  # contrasts


class LevelIntervals(NamedTuple):
    """Between which levels each pixel was before it was stored; shape ``(n,)`` each.

    ``step_dn`` is the usual width of those that are not clipped, ``usual_noise_dn`` the noise that
    is expected before rounding.
    """

    lower: FloatArray
    upper: FloatArray
    is_clipped: BoolArray
    step_dn: float
    usual_noise_dn: float


@compiled_part()
def clipped_pixels(stored: FloatArray, saturation_dn: float) -> BoolArray:
    """Which pixels are at the saturation level or at black; none where the former is not known.

    Levels below 0 are those of a dark level that was taken off: then 0 is no bound.
    """
    if not np.isfinite(saturation_dn):
        return np.zeros(len(stored), np.bool_)
    is_bound = stored >= NEARLY_SATURATED * saturation_dn
    if stored.min() >= _BLACK_DN:
        for i in range(len(stored)):
            is_bound[i] |= stored[i] <= _BLACK_DN
    return is_bound


@compiled_part()
def is_censored(is_clipped: BoolArray) -> bool:
    """Whether so many pixels are clipped that it matters, and others are left."""
    count = np.count_nonzero(is_clipped)
    return bool(_CENSORED_FROM * len(is_clipped) < count < len(is_clipped))


@compiled_part()
def level_intervals(
    stored: FloatArray,
    steps: LevelSteps,
    scatter: FloatArray,
    is_clipped: BoolArray,
    contrast_dn: float,
) -> LevelIntervals:
    """Intervals of levels from the steps in which they are stored, without end where clipped.

    Parameters
    ----------
    stored
        The levels as they are, shape ``(n,)``.
    steps
        Their steps. Where none were found, intervals are narrow beside the noise.
    scatter
        Residuals less what depends on the distance from the edge alone, shape ``(n,)``.
    is_clipped
        Which pixels tell a bound only, shape ``(n,)``.
    contrast_dn
        Contrast of the edge.
    """
    told, count = np.empty(len(scatter)), 0
    for i in range(len(scatter)):
        if not is_clipped[i]:
            told[count] = scatter[i]
            count += 1
    noise = np.sqrt(cut_variance(told[:count]))
    lower, upper, step = steps.lower.copy(), steps.upper.copy(), steps.step_dn
    if not steps.is_found:
        step = max(_FINE_STEP * noise, _LEAST_STEP * contrast_dn)
        lower, upper = stored - 0.5 * step, stored + 0.5 * step
    # The bound is one and the same for all, or levels just below it would count twice.
    least, largest = stored.min(), stored.max()
    middle = 0.5 * (least + largest)
    bright, dark = np.inf, -np.inf
    for i in range(len(stored)):
        if is_clipped[i] and stored[i] > middle:
            bright = min(bright, lower[i] if steps.is_found else stored[i])
        elif is_clipped[i]:
            dark = max(dark, upper[i] if steps.is_found else stored[i])
    for i in range(len(stored)):
        if is_clipped[i] and stored[i] > middle:
            lower[i], upper[i] = bright, largest + _UNBOUNDED * contrast_dn
        elif is_clipped[i]:
            lower[i], upper[i] = least - _UNBOUNDED * contrast_dn, dark
    has_clipped = bright < np.inf or dark > -np.inf
    usual = _USUAL_NOISE * step
    return LevelIntervals(
        lower, upper, is_clipped, step, max(usual, noise) if has_clipped else usual
    )


def seen_rise(low_dn: float, high_dn: float, saturation_dn: float) -> float:
    """Share of the rise from the dark to the bright level that lies between black and saturation.

    It is 1 where no level is beyond.
    """
    top = min(high_dn, NEARLY_SATURATED * saturation_dn)
    return (top - max(low_dn, _BLACK_DN)) / (high_dn - low_dn)
