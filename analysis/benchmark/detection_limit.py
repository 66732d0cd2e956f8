"""From which amplitude on a share of spots is found: a logistic curve in its logarithm.

The curve's two coefficients maximise Firth's penalised likelihood. It is finite also where every
spot above an amplitude is found and none below, where the plain likelihood has no maximum; the
amplitude of 50 % is then between the two.

References
----------
D. Firth, "Bias reduction of maximum likelihood estimates", Biometrika 80, 1993; G. Heinze,
M. Schemper, "A solution to the problem of separation in logistic regression", Statistics in
Medicine 21, 2002.
"""

from collections.abc import Sequence
from math import inf, log

import numpy as np

from analysis.benchmark.estimates import Estimate, Relation, percentiles
from simulation.arrays import BoolArray, FloatArray

_STEPS = 60
_CLOSE = 1e-9
_LONGEST_STEP = 2.0
_STEEPEST = 200.0
_LARGEST_LOGIT = 500.0


def limits_of(
    amplitudes: FloatArray, is_found: BoolArray, weights: FloatArray, shares: Sequence[float]
) -> FloatArray:
    """Amplitudes from which on shares of the spots are found, for several draws of the spots.

    Parameters
    ----------
    amplitudes
        Of the spots, positive, shape (n,).
    is_found
        Of each in each draw, shape (draws, n).
    weights
        How often each counts, shape (draws, n); not all 0 in a draw.
    shares
        Those wanted, each between 0 and 1.

    Returns
    -------
    ndarray of float64, shape (shares, draws)
        At least the smallest amplitude, never an extrapolation; infinite beyond the largest one.
    """
    of_log = np.log(amplitudes)
    least, most = float(of_log.min()), float(of_log.max())
    middle = weights @ of_log / weights.sum(axis=1)
    level, slope = _logistic(of_log - middle[:, None], is_found.astype(np.float64), weights)
    logits = np.array([log(share / (1 - share)) for share in shares])[:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        reached = np.where(slope > 0, middle + (logits - level) / slope, least)
    is_reached = level + slope * (most - middle) >= logits
    return np.where(is_reached, np.exp(np.clip(reached, least, most)), inf)


def limit_estimate(amplitudes: FloatArray, limits: FloatArray) -> Estimate:
    """Return a limit with its interval; a bound where the amplitudes tried do not reach it.

    Parameters
    ----------
    amplitudes
        Of all spots, shape (n,).
    limits
        That of all spots, and those of draws, shape (1 + draws,); infinite beyond the largest.
    """
    least, most = float(amplitudes.min()), float(amplitudes.max())
    value, drawn = float(limits[0]), limits[1:]
    ends = percentiles(drawn) if drawn.size else (inf, inf)
    low, high = (None if end == inf else end for end in ends)
    if value == inf:
        return Estimate(value=most, low=low, high=None, relation=">")
    relation: Relation = "<" if value <= least * (1 + _CLOSE) else "="
    return Estimate(value=value, low=low, high=high, relation=relation)


def _logistic(x: FloatArray, hit: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Level and slope of the logit of each draw by Newton's steps on Firth's score.

    All arguments have shape (draws, n), the weighted mean of ``x`` is 0.
    """
    beta = np.zeros((2, len(x)))
    for _ in range(_STEPS):
        logit = np.clip(beta[0][:, None] + beta[1][:, None] * x, -_LARGEST_LOGIT, _LARGEST_LOGIT)
        chance = 1 / (1 + np.exp(-logit))
        spread = weight * chance * (1 - chance)
        a, b, c = spread.sum(axis=1), (spread * x).sum(axis=1), (spread * x**2).sum(axis=1)
        a, c = a + 1e-300, c + _CLOSE * a + 1e-300  # of one amplitude there is no slope
        determinant = np.maximum(a * c - b**2, 1e-300)
        leverage = spread * (c[:, None] - 2 * b[:, None] * x + a[:, None] * x**2)
        away = weight * (hit - chance) + leverage / determinant[:, None] * (0.5 - chance)
        level, slope = away.sum(axis=1), (away * x).sum(axis=1)
        step = np.stack([c * level - b * slope, a * slope - b * level]) / determinant
        longest = np.abs(step).max(axis=0)
        step *= np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, _CLOSE))
        beta = np.clip(beta + step, -_STEEPEST, _STEEPEST)
        if longest.max() < _CLOSE:
            break
    return beta[0], beta[1]
