import numpy as np
import pytest
from hypothesis import given, strategies as st

from benchmarks.scoring import plot_change_roc, roc_of


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
