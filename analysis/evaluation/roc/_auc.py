"""AUC, and share found at a rate of false alarms, with their intervals over photographs.

How often one score exceeds others, ties counting half, is counted in O(n log n); every number is a
multiple of one half, and exact.

Intervals are symmetric in the logit, with Student's quantile. Where the variance is nothing (no
photograph differs from another, or all is found) it says nothing, and the share counts as one of so
many independent photographs: Clopper and Pearson's interval, which at shares of 0 and 1 is the
rule of three's exact form, ``0.025^(1/n)``.

Pairs that were cut from one photograph resemble each other, changed or not. The AUC wanted is that
of a threshold set on some photographs and used on others, so changed pairs are held against the
unchanged pairs of other photographs; the share over all pairs is too high where photographs differ
(``docs/evaluate-statistics.md`` has the sums, and how often the interval holds the truth).

A threshold at the k-th highest of n unchanged scores is exceeded by a further one with the chance
``k / (n + 1)``, whatever their distribution; so k is ``fpr (n + 1)``, and between two whole k the
share found is interpolated.

References
----------
C. J. Clopper, E. S. Pearson, "The use of confidence or fiducial limits illustrated in the case of
the binomial", Biometrika 26, 1934; E. L. Korn, B. I. Graubard, "Confidence intervals for
proportions with small expected number of positive counts estimated from survey data", Survey
Methodology 24, 1998 (shares of clusters); J. A. Hanley, A. Lippman-Hand, "If nothing goes wrong,
is everything all right?", JAMA 249, 1983 (rule of three).
E. R. DeLong, D. M. DeLong, D. L. Clarke-Pearson, "Comparing the areas under two or more correlated
receiver operating characteristic curves", Biometrics 44, 1988 (pairs that are independent);
N. A. Obuchowski, "Nonparametric analysis of clustered ROC curve data", Biometrics 53, 1997 (of all
comparisons, those within a photograph too); J. N. Arvesen, "Jackknifing U-statistics", Annals of
Mathematical Statistics 40, 1969.
S. S. Wilks, "Determination of sample sizes for setting tolerance limits", Annals of Mathematical
Statistics 12, 1941 (the chance above); M. S. Pepe, "The Statistical Evaluation of Medical Tests for
Classification and Prediction", 2003, section 5.2.3 (variance with the threshold's).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import exp, floor, inf, isinf, log, sqrt

import numpy as np
from scipy.special import betaincinv, ndtri, stdtrit

from simulation.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ScoredPairs:
    """Scores of pairs without and with a change, checked, with the number of their photograph.

    Parameters
    ----------
    unchanged, changed
        Shapes (n,) and (m,), higher where a pair looks more changed.
    unchanged_photograph, changed_photograph
        Numbers from 0 to ``photographs`` - 1, of the same shapes.
    photographs
        How many there are.
    """

    unchanged: FloatArray
    changed: FloatArray
    unchanged_photograph: IntArray
    changed_photograph: IntArray
    photographs: int

    @property
    def fewest_photographs(self) -> int:
        """Photographs with pairs of the kind, changed or not, that has fewer of them."""
        both = (self.unchanged_photograph, self.changed_photograph)
        return min(np.unique(numbers).size for numbers in both)

    def pairs_by_photograph(self) -> tuple[FloatArray, FloatArray]:
        """Number of pairs of each photograph without and with a change."""
        return (
            self.sums(self.unchanged_photograph, np.ones(self.unchanged.size)),
            self.sums(self.changed_photograph, np.ones(self.changed.size)),
        )

    def sums(self, photograph: IntArray, values: FloatArray) -> FloatArray:
        """Sums over the pairs of each photograph, shape (photographs,)."""
        totals = np.bincount(photograph, weights=values, minlength=self.photographs)
        return np.asarray(totals, np.float64)


def checked_scores(unchanged: FloatArray, changed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return both as float64.

    Raises
    ------
    ValueError
        If either is empty, not one-dimensional or not finite.
    """
    both = []
    for name, given in (("unchanged", unchanged), ("changed", changed)):
        scores = np.asarray(given, np.float64)
        if scores.ndim != 1 or scores.size == 0:
            raise ValueError(f"{name} must be a row of scores, got shape {scores.shape}")
        if bad := int(np.count_nonzero(~np.isfinite(scores))):
            raise ValueError(f"{name} holds {bad} scores that are not finite")
        both.append(scores)
    return both[0], both[1]


def _scored_pairs(
    unchanged: FloatArray,
    changed: FloatArray,
    unchanged_photograph: IntArray,
    changed_photograph: IntArray,
) -> ScoredPairs:
    """Check scores and number the photographs from 0.

    Raises
    ------
    ValueError
        If scores are missing or not finite, or a score has no photograph.
    """
    without, with_change = checked_scores(unchanged, changed)
    for name, scores, given in (
        ("unchanged", without, unchanged_photograph),
        ("changed", with_change, changed_photograph),
    ):
        if np.shape(given) != scores.shape:
            raise ValueError(f"{scores.size} {name} scores, but photographs of {np.shape(given)}")
    names, numbers = np.unique(
        np.concatenate([unchanged_photograph, changed_photograph]), return_inverse=True
    )
    return ScoredPairs(
        unchanged=without,
        changed=with_change,
        unchanged_photograph=numbers[: without.size].astype(np.int64),
        changed_photograph=numbers[without.size :].astype(np.int64),
        photographs=names.size,
    )


def exceeded(scores: FloatArray, others: FloatArray) -> FloatArray:
    """For each score the number of others that it exceeds, plus half of those that it equals."""
    ordered = np.sort(others)
    below = np.searchsorted(ordered, scores, side="left")
    return (below + np.searchsorted(ordered, scores, side="right")) / 2


def _exceeded_within(pairs: ScoredPairs) -> FloatArray:
    """Sum over the changed pairs of each photograph of the same photograph's unchanged exceeded."""
    ranks = _ranks((pairs.unchanged, pairs.changed))
    # Photographs one behind the other on one scale: nothing of a later one is below.
    span = int(max(rank.max() for rank in ranks)) + 1
    unchanged = (ranks[0] + span * pairs.unchanged_photograph).astype(np.float64)
    changed = (ranks[1] + span * pairs.changed_photograph).astype(np.float64)
    earlier = np.cumsum(pairs.pairs_by_photograph()[0])
    earlier = np.concatenate([[0.0], earlier[:-1]])[pairs.changed_photograph]
    return pairs.sums(pairs.changed_photograph, exceeded(changed, unchanged) - earlier)


def _ranks(rows: Iterable[FloatArray]) -> tuple[IntArray, IntArray]:
    """Two rows of scores as whole numbers in the same order, equal where scores are."""
    first, second = rows
    order = np.unique(np.concatenate([first, second]), return_inverse=True)[1].astype(np.int64)
    return order[: first.size], order[first.size :]


LEVEL = 0.95
_TAIL = (1 - LEVEL) / 2
_NORMAL = float(ndtri(1 - _TAIL))
_NO_VARIANCE = 1e-12
"""Of a share's largest variance: below, it is rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShareInterval:
    """95 % interval of a share; ``err`` is its standard error.

    Where the variance is nothing, ``err`` is what a normal interval of that width would have.
    """

    err: float
    low: float
    high: float


def share_interval(share: float, variance: float, freedom: float, units: int) -> ShareInterval:
    """Interval of a share, such as an AUC, in [0, 1].

    Parameters
    ----------
    share
        The estimate.
    variance
        Of the estimate; not used where ``freedom`` is 0.
    freedom
        Degrees of freedom of the variance; infinite for the normal quantile.
    units
        Independent units, photographs or pairs, that the share counts as one of where the variance
        is nothing.
    """
    spread = share * (1 - share)
    if freedom < 1 or not variance > _NO_VARIANCE * spread or spread <= 0:
        low, high = _clopper_pearson(share * units, units)
        return ShareInterval(err=(high - low) / (2 * _NORMAL), low=low, high=high)
    quantile = _NORMAL if isinf(freedom) else float(stdtrit(freedom, 1 - _TAIL))
    half = quantile * sqrt(variance) / spread
    logit = log(share / (1 - share))
    return ShareInterval(
        err=sqrt(variance), low=_share_of(logit - half), high=_share_of(logit + half)
    )


def _clopper_pearson(found: float, units: int) -> tuple[float, float]:
    """Also of a number found that is not whole."""
    low = float(betaincinv(found, units - found + 1, _TAIL)) if found > 0 else 0.0
    high = float(betaincinv(found + 1, units - found, 1 - _TAIL)) if found < units else 1.0
    return low, high


def _share_of(logit: float) -> float:
    """Inverse of the logit, without overflow."""
    if logit < 0:
        return exp(logit) / (1 + exp(logit)) if logit > -700 else 0.0
    return 1 / (1 + exp(-logit)) if logit < 700 else 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AucEstimate:
    """AUC with its standard error and its 95 % interval.

    Parameters
    ----------
    auc
        Chance that a changed pair scores above an unchanged pair of another photograph, ties
        counting half. Of any unchanged pair, where not ``is_by_photograph``.
    err, low, high
        Standard error and interval.
    auc_all_pairs
        Mann and Whitney's: of all pairs, also those of one photograph.
    photographs
        How many there were.
    is_by_photograph
        Whether the interval is over photographs. Else either kind of pairs came from a single one,
        all pairs counted as independent, and other photographs may have another AUC.
    """

    auc: float
    err: float
    low: float
    high: float
    auc_all_pairs: float
    photographs: int
    is_by_photograph: bool


def auc_interval(
    unchanged: FloatArray,
    changed: FloatArray,
    unchanged_group: IntArray,
    changed_group: IntArray,
) -> AucEstimate:
    """Estimate the AUC, and how sure it is.

    The variance is the jackknife's over photographs, the interval symmetric in the logit with
    Student's quantile. From two photographs, which the jackknife does not allow, it is that of
    their two comparisons with each other; from one, DeLong's over pairs, with the normal quantile.
    Where the variance is nothing, as at AUC 1, the interval is Clopper and Pearson's of so many
    photographs (or pairs of the rarer kind).

    Parameters
    ----------
    unchanged, changed
        Scores of pairs without and with a change, shapes (n,) and (m,), in any order.
    unchanged_group, changed_group
        The number of each pair's photograph, of the same shapes.

    Raises
    ------
    ValueError
        If scores are missing or not finite, or a score has no photograph.
    """
    pairs = _scored_pairs(unchanged, changed, unchanged_group, changed_group)
    placed = _Placements.of(pairs)
    units = pairs.fewest_photographs
    freedom: float = units - 1
    if units < 2:
        auc, variance, freedom = placed.auc, placed.delong_variance(), inf
        units = min(pairs.unchanged.size, pairs.changed.size)
    else:
        auc, variance = placed.between()
    interval = share_interval(auc, variance, freedom, units)
    return AucEstimate(
        auc=auc,
        err=interval.err,
        low=interval.low,
        high=interval.high,
        auc_all_pairs=placed.auc,
        photographs=pairs.photographs,
        is_by_photograph=pairs.fewest_photographs > 1,
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Placements:
    """Of each changed pair the share of unchanged ones below, of each unchanged of changed above.

    ``won`` and ``met`` are, for each photograph, the comparisons of its changed pairs with all
    unchanged ones and of its unchanged pairs with all changed ones, and of its own with its own:
    those in which the changed pair is higher, and all.
    """

    changed: FloatArray
    unchanged: FloatArray
    won: tuple[FloatArray, FloatArray, FloatArray]
    met: tuple[FloatArray, FloatArray, FloatArray]

    @classmethod
    def of(cls, pairs: ScoredPairs) -> "_Placements":
        below = exceeded(pairs.changed, pairs.unchanged)
        above = pairs.changed.size - exceeded(pairs.unchanged, pairs.changed)
        unchanged, changed = pairs.pairs_by_photograph()
        return cls(
            changed=below / pairs.unchanged.size,
            unchanged=above / pairs.changed.size,
            won=(
                pairs.sums(pairs.changed_photograph, below),
                pairs.sums(pairs.unchanged_photograph, above),
                _exceeded_within(pairs),
            ),
            met=(changed * unchanged.sum(), unchanged * changed.sum(), changed * unchanged),
        )

    @property
    def auc(self) -> float:
        """Mann and Whitney's."""
        return float(self.won[0].sum() / self.met[0].sum())

    def delong_variance(self) -> float:
        """Variance of the AUC if all pairs are independent; 0 where a kind has one pair only."""
        both = (self.changed, self.unchanged)
        if min(each.size for each in both) < 2:
            return 0.0
        return float(sum(each.var(ddof=1) / each.size for each in both))

    def between(self) -> tuple[float, float]:
        """AUC of pairs from different photographs, and its variance."""
        won, met = (all_[0] - all_[2] for all_ in (self.won, self.met))
        auc = float(won.sum() / met.sum())
        if won.size == 2:
            # Changed pairs of the one against the other's unchanged, and the reverse: no pair
            # is in both.
            return auc, 2 * float(np.sum((won - auc * met) ** 2) / met.sum() ** 2)
        won_left, met_left = (
            all_.sum() - all_ - other[1] + other[2]
            for all_, other in ((won, self.won), (met, self.met))
        )
        away = won_left / met_left - auc
        return auc, float(np.sum(away**2) * (away.size - 1) / away.size)


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
    pairs = _scored_pairs(unchanged, changed, unchanged_group, changed_group)
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
