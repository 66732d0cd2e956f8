"""ROC and precision-recall curves of scores, small enough for a figure.

References
----------
T. Fawcett, "An introduction to ROC analysis", Pattern Recognition Letters 27, 2006; J. Davis,
M. Goadrich, "The relationship between precision-recall and ROC curves", ICML 2006 (why precision is
not interpolated).
"""

from dataclasses import dataclass

import numpy as np

from analysis.evaluation.roc.placements import checked_scores
from analysis.evaluation.roc.thinning import needed_points
from simulation.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RocCurve:
    """Shares of pairs with a score of at least a threshold, as the threshold falls.

    Parameters
    ----------
    fpr, tpr
        Of pairs without and with a change, shape (n,), from (0, 0) to (1, 1).
    thresholds
        Shape (n,), falling; the first is infinite.
    """

    fpr: FloatArray
    tpr: FloatArray
    thresholds: FloatArray

    @property
    def area(self) -> float:
        """Area by trapezoids: Mann and Whitney's AUC, to 0.002 where points were left out."""
        return float(np.sum(np.diff(self.fpr) * (self.tpr[1:] + self.tpr[:-1])) / 2)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PrecisionRecall:
    """Precision over recall where one pair in two is changed, however many were scored.

    Parameters
    ----------
    recall, precision
        Share of the changed pairs found, and of changed pairs among those found, shape (n,).
    thresholds
        Shape (n,), falling.
    average_precision
        Sum of the precision over the steps of the recall, without interpolation.
    """

    recall: FloatArray
    precision: FloatArray
    thresholds: FloatArray
    average_precision: float


def roc_curve(unchanged: FloatArray, changed: FloatArray) -> RocCurve:
    """Receiver operating characteristic of scores without and with a change.

    Pairs with equal scores make one slanted step. Of many points only those are kept that a figure
    shows (``needed_points``).

    Raises
    ------
    ValueError
        If either kind is missing, or a score is not finite.
    """
    return _thinned(_whole_curve(unchanged, changed))


def precision_recall(unchanged: FloatArray, changed: FloatArray) -> PrecisionRecall:
    """Precision and recall at equal shares of changed and unchanged pairs.

    Raises
    ------
    ValueError
        If either kind is missing, or a score is not finite.
    """
    whole = _whole_curve(unchanged, changed)
    precision = whole.tpr[1:] / (whole.tpr[1:] + whole.fpr[1:])
    kept = _thinned(whole)
    return PrecisionRecall(
        recall=kept.tpr[1:],
        precision=kept.tpr[1:] / (kept.tpr[1:] + kept.fpr[1:]),
        thresholds=kept.thresholds[1:],
        average_precision=float(np.sum(np.diff(whole.tpr) * precision)),
    )


def _whole_curve(unchanged: FloatArray, changed: FloatArray) -> RocCurve:
    """One point for each score."""
    without, with_change = checked_scores(unchanged, changed)
    levels = np.unique(np.concatenate([without, with_change]))[::-1]
    fpr, tpr = (
        np.concatenate([[0.0], 1 - np.searchsorted(np.sort(each), levels) / each.size])
        for each in (without, with_change)
    )
    return RocCurve(fpr=fpr, tpr=tpr, thresholds=np.concatenate([[np.inf], levels]))


def _thinned(curve: RocCurve) -> RocCurve:
    kept = needed_points(curve.fpr, curve.tpr)
    return RocCurve(fpr=curve.fpr[kept], tpr=curve.tpr[kept], thresholds=curve.thresholds[kept])
