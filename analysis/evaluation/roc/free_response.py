"""Changes found against false marks: the free-response ROC of maps.

References
----------
P. C. Bunch, J. F. Hamilton, G. K. Sanderson, A. H. Simmons, "A free-response approach to the
measurement and characterization of radiographic-observer performance", J. Applied Photographic
Engineering 4, 1978; D. P. Chakraborty, "Maximum likelihood analysis of free-response receiver
operating characteristic (FROC) data", Medical Physics 16, 1989.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.evaluation.roc.marks import Disc, Marks
from analysis.evaluation.roc.thinning import needed_points
from simulation.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MarkedPair:
    """The marks of one pair, and its change, or None."""

    marks: Marks
    change: Disc | None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FrocCurve:
    """Changes found and false marks with scores of at least a threshold, as the threshold falls.

    As few marks of each pair are known (``MOST_MARKS``), the curve ends where they do.

    Parameters
    ----------
    false_marks_per_pair
        Marks that lie on no change over all pairs, with a change or without, shape (n,), from 0.
    found
        Share of the changes that a mark lies on, shape (n,), from 0.
    thresholds
        Shape (n,), falling; the first is infinite.
    """

    false_marks_per_pair: FloatArray
    found: FloatArray
    thresholds: FloatArray

    def found_at(self, false_marks_per_pair: float) -> float:
        """Share of the changes found at no more than so many false marks a pair."""
        within = np.flatnonzero(self.false_marks_per_pair <= false_marks_per_pair + 1e-12)
        return float(self.found[within[-1]])


def froc(pairs: Sequence[MarkedPair]) -> FrocCurve:
    """Free-response curve of pairs, of which some have a change.

    A change is found by the highest mark within its radius; others within it count neither as found
    nor as false.

    Raises
    ------
    ValueError
        If no pair has a change.
    """
    changes = sum(pair.change is not None for pair in pairs)
    if changes == 0:
        raise ValueError(f"none of {len(pairs)} pairs has a change")
    hits: list[float] = []
    false: list[FloatArray] = []
    for pair in pairs:
        scores = pair.marks.scores
        if pair.change is None:
            false.append(scores)
            continue
        is_on = pair.marks.is_within(pair.change)
        false.append(scores[~is_on])
        if is_on.any():
            hits.append(float(scores[is_on].max()))
    hit, missed = np.sort(np.array(hits, np.float64)), np.sort(np.concatenate(false))
    levels = np.unique(np.concatenate([hit, missed]))[::-1]
    found = _at_least(hit, levels) / changes
    false_marks = _at_least(missed, levels) / len(pairs)
    kept = needed_points(false_marks, found)
    return FrocCurve(
        false_marks_per_pair=false_marks[kept],
        found=found[kept],
        thresholds=np.concatenate([[np.inf], levels])[kept],
    )


def _at_least(ordered: FloatArray, levels: FloatArray) -> FloatArray:
    """Number of scores that reach each level, after the 0 that reach infinity."""
    return np.concatenate([[0.0], ordered.size - np.searchsorted(ordered, levels)])
