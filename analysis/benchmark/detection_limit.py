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

from math import exp, inf, log

import numpy as np

from analysis.benchmark.estimates import Estimate, percentiles
from simulation.arrays import BoolArray, FloatArray

_STEPS = 60
_CLOSE = 1e-9
_LONGEST_STEP = 2.0
_STEEPEST = 200.0


def limit_of(
    amplitudes: FloatArray, is_found: BoolArray, weights: FloatArray, found: float
) -> float:
    """Amplitude from which on a share of the spots is found.

    Parameters
    ----------
    amplitudes
        Of the spots, positive, shape (n,).
    is_found
        Of each, shape (n,).
    weights
        How often each counts, shape (n,).
    found
        The share wanted, between 0 and 1.

    Returns
    -------
    float
        At least the smallest amplitude, never an extrapolation; infinite beyond the largest one.
    """
    counted = weights > 0
    if not counted.any():
        return inf
    hit, weight = is_found[counted], weights[counted]
    log_amplitude = np.log(amplitudes[counted])
    middle = float(np.average(log_amplitude, weights=weight))
    level, slope = _logistic(log_amplitude - middle, hit.astype(np.float64), weight)
    least, most = log(amplitudes.min()), log(amplitudes.max())
    if not slope > 0:
        return exp(least) if level > log(found / (1 - found)) else inf
    at = middle + (log(found / (1 - found)) - level) / slope
    return inf if at > most else exp(max(at, least))


def limit_estimate(amplitudes: FloatArray, value: float, drawn: FloatArray) -> Estimate:
    """Return a limit with its interval; a bound where the amplitudes tried do not reach it.

    Parameters
    ----------
    amplitudes
        Of all spots, shape (n,).
    value
        The limit; infinite beyond the largest amplitude.
    drawn
        Limits of the draws.
    """
    least, most = float(amplitudes.min()), float(amplitudes.max())
    ends = percentiles(drawn) if drawn.size else (inf, inf)
    low, high = (None if end == inf else end for end in ends)
    if value == inf:
        return Estimate(value=most, low=low, high=None, relation=">")
    relation = "<" if value <= least * (1 + _CLOSE) else "="
    return Estimate(value=value, low=low, high=high, relation=relation)


def _logistic(x: FloatArray, hit: FloatArray, weight: FloatArray) -> tuple[float, float]:
    """Level and slope of the logit by Newton's steps on Firth's score."""
    design = np.column_stack([np.ones_like(x), x])
    beta = np.zeros(2)
    for _ in range(_STEPS):
        chance = 1 / (1 + np.exp(-np.clip(design @ beta, -500, 500)))
        spread = weight * chance * (1 - chance)
        information = (design * spread[:, None]).T @ design
        ridge = information + np.eye(2) * 1e-12 * max(float(np.trace(information)), 1e-12)
        inverse = np.linalg.pinv(ridge)
        leverage = spread * np.einsum("ni,ij,nj->n", design, inverse, design)
        score = design.T @ (weight * (hit - chance) + leverage * (0.5 - chance))
        step = inverse @ score
        longest = float(np.abs(step).max())
        step *= min(1.0, _LONGEST_STEP / longest) if longest > 0 else 1.0
        beta = np.clip(beta + step, -_STEEPEST, _STEEPEST)
        if longest < _CLOSE:
            break
    return float(beta[0]), float(beta[1])
