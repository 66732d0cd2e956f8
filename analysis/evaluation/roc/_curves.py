"""ROC, precision-recall and free-response curves, small enough for a figure, and the marks of maps.

References
----------
T. Fawcett, "An introduction to ROC analysis", Pattern Recognition Letters 27, 2006; J. Davis,
M. Goadrich, "The relationship between precision-recall and ROC curves", ICML 2006 (why precision is
not interpolated).
P. C. Bunch, J. F. Hamilton, G. K. Sanderson, A. H. Simmons, "A free-response approach to the
measurement and characterization of radiographic-observer performance", J. Applied Photographic
Engineering 4, 1978; D. P. Chakraborty, "Maximum likelihood analysis of free-response receiver
operating characteristic (FROC) data", Medical Physics 16, 1989.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.ndimage import maximum_filter

from analysis.evaluation.roc._auc import checked_scores
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray

MOST_POINTS = 400


def needed_points(across: FloatArray, up: FloatArray) -> IntArray:
    """Indices of the points to keep of a curve that nowhere falls; the first and last among them.

    Points on a straight line between two others are dropped, which changes nothing. If more than
    ``MOST_POINTS`` are left, one is kept per step of ``2 / (MOST_POINTS - 2)`` in the sum of both
    coordinates, each as a share of its largest: no point is then further than that from the curve.

    Parameters
    ----------
    across, up
        Shape (n,), at least one point, neither falling.
    """
    steps = np.stack([np.diff(across), np.diff(up)])
    cross = steps[0, :-1] * steps[1, 1:] - steps[0, 1:] * steps[1, :-1]
    # Counts over counts: what is straight crosses by rounding alone.
    scale = np.linalg.norm(steps[:, :-1], axis=0) * np.linalg.norm(steps[:, 1:], axis=0)
    is_corner = np.ones(across.size, dtype=np.bool_)
    is_corner[1:-1] = np.abs(cross) > 1e-9 * scale
    kept = np.flatnonzero(is_corner).astype(np.int64)
    if kept.size <= MOST_POINTS:
        return kept
    shares = [each[kept] / max(float(each[-1]), np.finfo(float).tiny) for each in (across, up)]
    cell = np.floor((shares[0] + shares[1]) * ((MOST_POINTS - 2) / 2))
    is_first = np.ones(kept.size, dtype=np.bool_)
    is_first[1:-1] = np.diff(cell[:-1]) > 0
    return kept[is_first]


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


MOST_MARKS = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Disc:
    """A change's place: follow-up pixels, ``(0, 0)`` the centre of the first one, and radius."""

    x_px: float
    y_px: float
    radius_px: float

    def __post_init__(self) -> None:
        if not self.radius_px > 0:
            raise ValueError(f"radius_px must be positive, got {self.radius_px}")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Marks:
    """Scores and places of a map's marks, shape (k,), highest first; pixel centres at integers."""

    scores: FloatArray
    x_px: FloatArray
    y_px: FloatArray

    def is_within(self, disc: Disc) -> BoolArray:
        """Which of them lie in a disc, its rim included, shape (k,)."""
        return np.hypot(self.x_px - disc.x_px, self.y_px - disc.y_px) <= disc.radius_px


def marks_of(change_map: Float32Array, count: int, apart_px: float) -> Marks:
    """Find the highest local maxima of a map.

    A mark is a pixel that none within ``apart_px`` exceeds; of equal ones so near to each other the
    first by rows counts. NaN and -inf are pixels that do not count.

    Parameters
    ----------
    change_map
        Shape (rows, cols), higher where it looks more changed.
    count
        Marks at most, from 1 to ``MOST_MARKS``.
    apart_px
        Least distance of two marks, in pixels, at least 1.

    Raises
    ------
    ValueError
        If the map is not two-dimensional, or an argument is out of its range.
    """
    if change_map.ndim != 2 or change_map.size == 0:
        raise ValueError(f"a map has rows and columns, got shape {change_map.shape}")
    if not 1 <= count <= MOST_MARKS:
        raise ValueError(f"count must be from 1 to {MOST_MARKS}, got {count}")
    if not apart_px >= 1:
        raise ValueError(f"apart_px must be at least 1, got {apart_px}")
    levels = np.where(np.isnan(change_map), -np.inf, change_map)
    # A square inside of the disc takes two passes; its few maxima are asked for the disc singly.
    side = 2 * int(apart_px / sqrt(2)) + 1
    is_candidate = (levels == maximum_filter(levels, size=side)) & (levels > -np.inf)
    y, x = np.nonzero(is_candidate)
    is_left = np.ones(y.size, dtype=np.bool_)
    chosen: list[int] = []
    for each in np.argsort(-levels[y, x], kind="stable").tolist():
        if len(chosen) == count:
            break
        if is_left[each] and _is_highest(levels, int(y[each]), int(x[each]), apart_px):
            chosen.append(each)
            is_left &= np.hypot(x - x[each], y - y[each]) > apart_px
    return Marks(
        scores=levels[y, x][chosen].astype(np.float64),
        x_px=x[chosen].astype(np.float64),
        y_px=y[chosen].astype(np.float64),
    )


def _is_highest(levels: Float32Array, y: int, x: int, radius_px: float) -> bool:
    """Whether no pixel of the disc around one exceeds it."""
    reach = int(radius_px)
    top, left = max(y - reach, 0), max(x - reach, 0)
    around = levels[top : y + reach + 1, left : x + reach + 1]
    rows, cols = np.indices(around.shape)
    is_near = np.hypot(rows + top - y, cols + left - x) <= radius_px
    return not np.any(around[is_near] > levels[y, x])


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
