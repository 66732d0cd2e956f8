import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.special import ndtr

from analysis.changes.detection.chance import FilterWidth, significance_threshold
from benchmarks.truth.change_roc import plot_change_roc, roc_of


def test_a_worked_example() -> None:
    found = roc_of(np.array([4.0, 3.0, 1.0, 1.0]), np.array([3.0, 2.0, 1.0, 0.0]))
    assert [found.false_at(rate) for rate in (0.25, 0.5, 0.75, 1.0)] == [0, 1, 3, 3]
    assert "pixels" in plot_change_roc({"filter": found}).axes[0].get_xlabel()


@given(seed=st.integers(0, 1000), scale=st.floats(0.1, 10.0))
def test_a_monotone_change_of_the_score_leaves_the_curve(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0.1, 1.0, 30), rng.uniform(0.0, 0.9, 40)
    one, other = roc_of(a, b), roc_of(np.exp(scale * a), np.exp(scale * b))
    np.testing.assert_array_equal(one.true_positive_rate, other.true_positive_rate)
    np.testing.assert_array_equal(one.false_positive_rate, other.false_positive_rate)


def test_scores_of_one_kind_only_are_refused() -> None:
    with pytest.raises(ValueError):
        roc_of(np.array([]), np.array([1.0]))


@given(rate=st.floats(1e-9, 0.5))
def test_the_threshold_allows_for_a_spread_that_is_not_known_exactly(rate: float) -> None:
    threshold = significance_threshold(rate, (FilterWidth(width_px=1.0),))
    # A tail is fuller where the spread is not known exactly.
    nodes, weights = np.polynomial.hermite_e.hermegauss(15)
    exact = 2 * ndtr(-threshold / (1 + 0.03 * nodes)) @ weights / weights.sum()
    assert exact == pytest.approx(rate, rel=1e-6)
    assert threshold > -1e-9
    if rate < 1e-3:
        assert 2 * ndtr(-threshold) < rate
