"""TPR at a rate of false alarms: order statistics by hand, closed forms, invariants."""

from math import sqrt

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.special import ndtr, ndtri

from analysis.evaluation.roc import tpr_at_fpr
from simulation.arrays import FloatArray


def test_the_threshold_is_exceeded_by_a_further_unchanged_pair_at_the_rate_asked_for() -> None:
    photographs = np.repeat(np.arange(3), 13)
    unchanged = np.arange(39.0)
    # Of 39 the second highest, 37, is exceeded by a fortieth with the chance of 2 in 40.
    changed = np.arange(30.0, 49.1, 0.5)
    found = tpr_at_fpr(unchanged, changed, photographs, photographs, 0.05)
    assert found.threshold == pytest.approx(37.0)
    assert found.tpr == pytest.approx(24 / 39)  # those from 37.5 to 49
    assert found.fpr == 0.05
    between = tpr_at_fpr(unchanged, changed, photographs, photographs, 0.0625)
    assert between.threshold == pytest.approx(36.5)
    assert between.tpr == pytest.approx((24 + 26) / 2 / 39)


def test_of_too_few_unchanged_pairs_the_rate_is_the_least_that_they_tell() -> None:
    alone = np.zeros(9, np.int64)
    found = tpr_at_fpr(np.arange(9.0), np.arange(9.0) + 5.5, alone, alone, 0.05)
    assert found.fpr == pytest.approx(0.1)
    assert found.threshold == 8.0
    assert found.tpr == pytest.approx(6 / 9)
    assert not found.is_by_photograph


@pytest.mark.slow
@given(st.integers(2, 6), st.integers(0, 2**32 - 1), st.sampled_from([0.02, 0.05, 0.2, 0.5]))
def test_rising_transforms_and_other_names_of_photographs_leave_share_and_interval(
    photographs: int, seed: int, fpr: float
) -> None:
    rng = np.random.default_rng(seed)
    of = np.repeat(np.arange(photographs), 4)
    unchanged, changed = rng.normal(0, 1, of.size), rng.normal(1, 1, of.size)
    found = tpr_at_fpr(unchanged, changed, of, of, fpr)
    other = tpr_at_fpr(np.exp(unchanged), np.exp(changed), 9 - of, 9 - of, fpr)
    assert found.is_by_photograph
    assert 0 <= found.low <= found.tpr <= found.high <= 1
    assert found.low < found.high
    assert (other.tpr, other.err, other.low, other.high) == pytest.approx(
        (found.tpr, found.err, found.low, found.high), rel=1e-9, abs=1e-12
    )


def test_its_error_over_photographs_is_at_least_the_jackknifes_by_definition() -> None:
    equal = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        of = np.repeat(np.arange(4), 10)
        unchanged, changed = rng.normal(0, 1, 40), rng.normal(1, 1, 40)
        found = tpr_at_fpr(unchanged, changed, of, of, 0.1)
        left = [
            tpr_at_fpr(unchanged[kept], changed[kept], of[kept], of[kept], 0.1)
            for kept in (of != each for each in range(4))
        ]
        jackknife = sqrt(3 / 4 * sum((each.tpr - found.tpr) ** 2 for each in left))
        assert found.err >= jackknife - 1e-12
        equal += found.err == pytest.approx(jackknife)
    assert 0 < equal < 8  # either is the larger sometimes


@pytest.mark.parametrize("is_alone", [False, True])
def test_of_binormal_scores_it_is_the_closed_form_with_its_error(*, is_alone: bool) -> None:
    rng = np.random.default_rng(8)
    pairs = 4000
    of = np.zeros(pairs, np.int64) if is_alone else np.arange(pairs) % 400
    found = tpr_at_fpr(rng.normal(0, 1, pairs), rng.normal(1.5, 1, pairs), of, of, 0.05)
    level = -float(ndtri(0.05))
    truth = float(ndtr(1.5 - level))
    assert found.tpr == pytest.approx(truth, abs=3.29 * found.err)  # 999 of 1000
    # Binomial, and the threshold's through the curve's slope, a ratio of densities.
    slope = np.exp((level**2 - (level - 1.5) ** 2) / 2)
    expected = sqrt((truth * (1 - truth) + slope**2 * 0.05 * 0.95) / pairs)
    # The jackknife of a quantile follows few order statistics: its variance scatters.
    assert found.err == pytest.approx(expected, rel=0.2 if is_alone else 0.4)


@pytest.mark.slow
def test_95_of_100_intervals_over_photographs_hold_the_truth() -> None:
    # At the rate measured for such photographs, 94 %, 267 to 295 of 300 do, 999 times of 1000.
    rng = np.random.default_rng(2)
    of = np.repeat(np.arange(20), 10)
    truth, held = float(ndtr(1.5 + ndtri(0.05))), 0

    def scores() -> FloatArray:
        return np.asarray(
            sqrt(0.5) * rng.standard_normal(20)[of] + sqrt(0.5) * rng.standard_normal(of.size)
        )

    for _ in range(300):
        found = tpr_at_fpr(scores(), scores() + 1.5, of, of, 0.05)
        held += found.low <= truth <= found.high
    assert 267 <= held <= 295


@pytest.mark.parametrize("fpr", [0.0, 1.0, -0.1, np.nan])
def test_a_rate_that_is_none_is_refused(fpr: float) -> None:
    alone = np.zeros(2, np.int64)
    with pytest.raises(ValueError, match="fpr"):
        tpr_at_fpr(np.zeros(2), np.ones(2), alone, alone, fpr)
