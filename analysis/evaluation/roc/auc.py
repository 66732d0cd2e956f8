"""Area under the ROC curve, and its interval over photographs.

Pairs that were cut from one photograph resemble each other, changed or not. The AUC wanted is that
of a threshold set on some photographs and used on others, so changed pairs are held against the
unchanged pairs of other photographs; the share over all pairs is too high where photographs differ
(``docs/evaluate-statistics.md`` has the sums, and how often the interval holds the truth).

References
----------
E. R. DeLong, D. M. DeLong, D. L. Clarke-Pearson, "Comparing the areas under two or more correlated
receiver operating characteristic curves", Biometrics 44, 1988 (pairs that are independent);
N. A. Obuchowski, "Nonparametric analysis of clustered ROC curve data", Biometrics 53, 1997 (of all
comparisons, those within a photograph too); J. N. Arvesen, "Jackknifing U-statistics", Annals of
Mathematical Statistics 40, 1969.
"""

from dataclasses import dataclass
from math import inf

import numpy as np

from analysis.evaluation.roc.placements import (
    ScoredPairs,
    exceeded,
    exceeded_within,
    scored_pairs,
)
from analysis.evaluation.roc.share_interval import share_interval
from simulation.arrays import FloatArray, IntArray


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
    pairs = scored_pairs(unchanged, changed, unchanged_group, changed_group)
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
                exceeded_within(pairs),
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
