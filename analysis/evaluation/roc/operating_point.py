"""Share of changed pairs found at a rate of false alarms, with the error of the threshold.

A threshold at the k-th highest of n unchanged scores is exceeded by a further one with the chance
``k / (n + 1)``, whatever their distribution; so k is ``fpr (n + 1)``, and between two whole k the
share found is interpolated.

References
----------
S. S. Wilks, "Determination of sample sizes for setting tolerance limits", Annals of Mathematical
Statistics 12, 1941 (the chance above); M. S. Pepe, "The Statistical Evaluation of Medical Tests for
Classification and Prediction", 2003, section 5.2.3 (variance with the threshold's).
"""

from dataclasses import dataclass
from math import exp, floor

import numpy as np
from scipy.special import ndtri

from analysis.evaluation.roc.placements import ScoredPairs, scored_pairs
from analysis.evaluation.roc.share_interval import share_interval
from simulation.arrays import FloatArray, IntArray

_AROUND = 2.5
"""The slope is taken between the rate over this and the rate times this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TprEstimate:
    """Share of the changed pairs found, with its standard error and its 95 % interval.

    Parameters
    ----------
    tpr, err, low, high
        Share, standard error and interval.
    fpr
        The rate of false alarms that it is for: the one asked for, or ``1 / (n + 1)`` where n
        unchanged pairs are too few for that.
    threshold
        Pairs that score above are found.
    is_by_photograph
        Whether the interval is over photographs, as of ``AucEstimate``.
    """

    tpr: float
    err: float
    low: float
    high: float
    fpr: float
    threshold: float
    is_by_photograph: bool


def tpr_at_fpr(
    unchanged: FloatArray,
    changed: FloatArray,
    unchanged_group: IntArray,
    changed_group: IntArray,
    fpr: float,
) -> TprEstimate:
    """Estimate the share of changed pairs found where unchanged ones are flagged at a rate.

    The variance is the larger of two over photographs: the jackknife's, which sets the threshold
    anew without each, and that of the share less the threshold's share times the curve's slope. The
    first follows few order statistics, the second a slope that is measured; either alone is too
    small too often. From one photograph it is the second, of pairs that are independent.

    Parameters
    ----------
    unchanged, changed
        Scores of pairs without and with a change, shapes (n,) and (m,), in any order.
    unchanged_group, changed_group
        The number of each pair's photograph, of the same shapes.
    fpr
        Rate of false alarms, between 0 and 1.

    Raises
    ------
    ValueError
        If scores are missing or not finite, a score has no photograph, or the rate is outside.
    """
    if not 0 < fpr < 1:
        raise ValueError(f"fpr must lie between 0 and 1, got {fpr}")
    pairs = scored_pairs(unchanged, changed, unchanged_group, changed_group)
    tpr, threshold = _found(pairs.unchanged, pairs.changed, fpr)
    units = pairs.fewest_photographs
    if is_by_photograph := units > 1:
        variance = max(_jackknife_variance(pairs, fpr, tpr), _linear_variance(pairs, fpr))
    else:
        variance = _pairs_variance(pairs.unchanged, pairs.changed, fpr)
        units = min(pairs.unchanged.size, pairs.changed.size)
    interval = share_interval(tpr, variance, units - 1, units)
    return TprEstimate(
        tpr=tpr,
        err=interval.err,
        low=interval.low,
        high=interval.high,
        fpr=max(fpr, 1 / (pairs.unchanged.size + 1)),
        threshold=threshold,
        is_by_photograph=is_by_photograph,
    )


def _found(unchanged: FloatArray, changed: FloatArray, fpr: float) -> tuple[float, float]:
    """Share of the changed above the threshold, and the threshold."""
    falling = np.sort(unchanged)[::-1]
    rank = _rank(falling.size, fpr)
    first = floor(rank)
    between = rank - first
    upper, lower = falling[first - 1], falling[min(first, falling.size - 1)]
    above = [float(np.mean(changed > level)) for level in (upper, lower)]
    return (
        (1 - between) * above[0] + between * above[1],
        float((1 - between) * upper + between * lower),
    )


def _rank(count: int, fpr: float) -> float:
    """The threshold's rank among so many scores, 1 the highest."""
    return min(max(fpr * (count + 1), 1.0), float(count))


def _jackknife_variance(pairs: ScoredPairs, fpr: float, tpr: float) -> float:
    """Variance from leaving out one photograph after the other."""
    away = [
        _found(
            pairs.unchanged[pairs.unchanged_photograph != photograph],
            pairs.changed[pairs.changed_photograph != photograph],
            fpr,
        )[0]
        - tpr
        for photograph in range(pairs.photographs)
    ]
    return float(np.sum(np.square(away)) * (len(away) - 1) / len(away))


def _linear_variance(pairs: ScoredPairs, fpr: float) -> float:
    """Variance over photographs, by the slope of the curve."""
    # One of the scores, as a threshold between two depends on more than their order.
    falling = np.sort(pairs.unchanged)[::-1]
    level = falling[floor(_rank(falling.size, fpr)) - 1]
    is_found, is_flagged = pairs.changed > level, pairs.unchanged > level
    away = pairs.sums(pairs.changed_photograph, is_found - is_found.mean()) / is_found.size
    slope = _slope(pairs.unchanged, pairs.changed, fpr)
    away -= slope * (
        pairs.sums(pairs.unchanged_photograph, is_flagged - is_flagged.mean()) / is_flagged.size
    )
    return float(np.sum(away**2) * away.size / (away.size - 1))


def _pairs_variance(unchanged: FloatArray, changed: FloatArray, fpr: float) -> float:
    """Variance of independent pairs, by the slope of the curve."""
    least = 0.5 / changed.size
    tpr = float(np.clip(_found(unchanged, changed, fpr)[0], least, 1 - least))
    slope = _slope(unchanged, changed, fpr)
    return tpr * (1 - tpr) / changed.size + slope**2 * fpr * (1 - fpr) / unchanged.size


def _slope(unchanged: FloatArray, changed: FloatArray, fpr: float) -> float:
    """Slope of the ROC curve, from a straight line on normal axes around the rate."""
    least = 0.5 / changed.size
    rates, shares = [], []
    for rate in (fpr / _AROUND, fpr, min(fpr * _AROUND, (1 + fpr) / 2)):
        rates.append(float(ndtri(max(rate, 1 / (unchanged.size + 1)))))
        share = _found(unchanged, changed, rate)[0]
        shares.append(float(ndtri(np.clip(share, least, 1 - least))))
    # Of too few unchanged pairs both rates are one: equal variances then.
    bend = (shares[2] - shares[0]) / (rates[2] - rates[0]) if rates[2] > rates[0] else 1.0
    return bend * exp((float(ndtri(fpr)) ** 2 - shares[1] ** 2) / 2)
