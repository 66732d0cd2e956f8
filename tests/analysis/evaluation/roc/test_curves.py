"""ROC and precision-recall: worked examples, and what leaving out points may change."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import mannwhitneyu

from analysis.evaluation.roc import precision_recall, roc_curve
from analysis.evaluation.roc._curves import MOST_POINTS

some_scores = st.lists(st.integers(-5, 5), min_size=1, max_size=30).map(
    lambda scores: np.array(scores, np.float64)
)


def test_a_worked_curve() -> None:
    curve = roc_curve(np.array([0.0, 1.0, 2.0]), np.array([1.0, 3.0, 3.0]))
    # Above 3 nothing; from 3 two of the changed; from 2 an unchanged; at 1 one of each at once.
    assert curve.thresholds.tolist() == [np.inf, 3.0, 2.0, 1.0, 0.0]
    assert curve.tpr.tolist() == pytest.approx([0, 2 / 3, 2 / 3, 1, 1])
    assert curve.fpr.tolist() == pytest.approx([0, 0, 1 / 3, 2 / 3, 1])
    assert curve.area == pytest.approx((2 + 3 + 2.5) / 9)


@pytest.mark.slow
@given(some_scores, some_scores)
def test_its_area_is_mann_and_whitneys_statistic(
    unchanged: np.ndarray, changed: np.ndarray
) -> None:
    expected = mannwhitneyu(changed, unchanged).statistic / (changed.size * unchanged.size)
    curve = roc_curve(unchanged, changed)
    assert curve.area == pytest.approx(expected, abs=1e-12)
    assert (curve.fpr[0], curve.tpr[0], curve.fpr[-1], curve.tpr[-1]) == (0, 0, 1, 1)
    assert np.all(np.diff(curve.thresholds) < 0)


def test_of_ten_thousand_pairs_few_points_are_kept_and_none_is_missed() -> None:
    rng = np.random.default_rng(3)
    unchanged, changed = rng.normal(0, 1, 10_000), rng.normal(1, 1, 10_000)
    curve = roc_curve(unchanged, changed)
    assert curve.fpr.size <= MOST_POINTS
    exact = mannwhitneyu(changed, unchanged).statistic / 1e8
    assert curve.area == pytest.approx(exact, abs=0.002)
    # Every point kept is one of the whole curve.
    for at in range(1, curve.fpr.size, 40):
        assert curve.fpr[at] == pytest.approx(np.mean(unchanged >= curve.thresholds[at]))
        assert curve.tpr[at] == pytest.approx(np.mean(changed >= curve.thresholds[at]))


def test_straight_stretches_are_two_points() -> None:
    curve = roc_curve(np.arange(50.0), 100 + np.arange(70.0))
    assert list(zip(curve.fpr.tolist(), curve.tpr.tolist(), strict=True)) == [
        (0, 0),
        (0, 1),
        (1, 1),
    ]


def test_a_worked_precision_and_recall() -> None:
    # Of changed 4, 2 and unchanged 3, 1: recall 1/2, 1/2, 1, 1; precision 1, 1/2, 2/3, 1/2.
    found = precision_recall(np.array([3.0, 1.0]), np.array([4.0, 2.0]))
    assert found.recall.tolist() == [0.5, 0.5, 1.0, 1.0]
    assert found.precision.tolist() == pytest.approx([1.0, 0.5, 2 / 3, 0.5])
    assert found.average_precision == pytest.approx(0.5 * 1 + 0.5 * 2 / 3)


@given(some_scores, some_scores, st.integers(1, 5))
def test_precision_is_that_of_equal_shares_however_many_were_scored(
    unchanged: np.ndarray, changed: np.ndarray, copies: int
) -> None:
    one = precision_recall(unchanged, changed)
    other = precision_recall(np.tile(unchanged, copies), changed)
    assert other.average_precision == pytest.approx(one.average_precision)
    assert other.precision == pytest.approx(one.precision)


def test_a_detector_that_says_the_same_of_all_pairs_is_right_in_half() -> None:
    assert precision_recall(np.zeros(9), np.zeros(4)).average_precision == 0.5
    assert precision_recall(np.zeros(9), np.ones(4)).average_precision == 1.0
