"""How often one score exceeds others, ties counting half: in O(n log n), in all and by photograph.

Every number is a multiple of one half, and exact.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

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


def scored_pairs(
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


def exceeded_within(pairs: ScoredPairs) -> FloatArray:
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
