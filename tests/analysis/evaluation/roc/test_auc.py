"""The AUC and its interval: closed forms, the definitions in O(n^2), what may not change them."""

from math import exp, log, pi, sqrt, tan
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.special import ndtri, stdtrit
from scipy.stats import mannwhitneyu

from analysis.detectability import auc_of, d_prime_of_auc
from analysis.evaluation.roc import AucEstimate, auc_interval, share_interval
from simulation.arrays import FloatArray, IntArray

Scored = tuple[FloatArray, FloatArray, IntArray, IntArray]


def one_photograph(unchanged: FloatArray, changed: FloatArray) -> AucEstimate:
    groups = np.zeros(unchanged.size, np.int64), np.zeros(changed.size, np.int64)
    return auc_interval(unchanged, changed, *groups)


@st.composite
def scored(draw: st.DrawFn, photographs: int = 5) -> Scored:
    """A few scores, ties among them, from up to so many photographs."""
    score, photograph = st.integers(-4, 4), st.integers(1, photographs)
    both = [draw(st.lists(st.tuples(score, photograph), min_size=1, max_size=12)) for _ in "ab"]
    scores = [np.array([row[0] for row in rows], np.float64) for rows in both]
    groups = [np.array([row[1] for row in rows], np.int64) for rows in both]
    return scores[0], scores[1], groups[0], groups[1]


def numbers(estimate: AucEstimate) -> list[float]:
    return [estimate.auc, estimate.err, estimate.low, estimate.high, estimate.auc_all_pairs]


def wins(unchanged: FloatArray, changed: FloatArray) -> FloatArray:
    """By definition: 1, 1/2 or 0 for each changed (rows) against each unchanged pair."""
    away = changed[:, None] - unchanged[None]
    return np.asarray((np.sign(away) + 1) / 2)


def binormal(
    rng: np.random.Generator, d_prime: float, photographs: int, pairs: int, share: float = 0.0
) -> Scored:
    """Scores whose photographs add so large a share of the variance, to both kinds alike."""
    of = np.repeat(np.arange(photographs), pairs)
    own = sqrt(share) * rng.standard_normal(photographs)[of]
    each = sqrt(1 - share) * rng.standard_normal((2, of.size))
    return own + each[0], own + each[1] + d_prime, of, of


def test_a_worked_example() -> None:
    # Changed 3, 1, 4, 2; unchanged 0, 2, 1: of twelve comparisons 3 + 1.5 + 3 + 2.5 = 10 are won.
    # Placements of the changed 1, 1/2, 1, 5/6 (variance 1/18), of the unchanged 1, 5/8, 7/8
    # (variance 7/192); variance of the AUC 1/18/4 + 7/192/3 = 0.026042.
    estimate = one_photograph(np.array([0.0, 2.0, 1.0]), np.array([3.0, 1.0, 4.0, 2.0]))
    assert estimate.auc == estimate.auc_all_pairs == pytest.approx(10 / 12)
    assert estimate.err == pytest.approx(sqrt(1 / 72 + 7 / 576))
    half = 1.959964 * estimate.err * 36 / 5  # the logit's slope is 1 / (5/6 * 1/6)
    assert estimate.low == pytest.approx(1 / (1 + exp(half - log(5))), rel=1e-6)
    assert estimate.high == pytest.approx(1 / (1 + exp(-half - log(5))), rel=1e-6)
    assert not estimate.is_by_photograph
    assert estimate.photographs == 1


@given(scored())
@settings(max_examples=40)
def test_it_is_mann_and_whitneys_statistic(pairs: Scored) -> None:
    unchanged, changed = pairs[:2]
    expected = mannwhitneyu(changed, unchanged).statistic / (changed.size * unchanged.size)
    assert auc_interval(*pairs).auc_all_pairs == pytest.approx(expected, abs=1e-12)


@given(scored())
def test_the_variance_of_independent_pairs_is_delongs_by_definition(pairs: Scored) -> None:
    table = wins(*pairs[:2])
    if min(table.shape) < 2:
        return
    expected = sum(
        float(np.var(table.mean(axis=axis), ddof=1)) / table.shape[1 - axis] for axis in (0, 1)
    )
    estimate = one_photograph(*pairs[:2])
    if 0 < estimate.auc < 1 and expected > 1e-9:
        assert estimate.err == pytest.approx(sqrt(expected), rel=1e-9)


@given(scored())
@settings(max_examples=40)
def test_between_photographs_it_is_the_share_and_the_jackknife_by_definition(pairs: Scored) -> None:
    unchanged, changed, unchanged_group, changed_group = pairs
    kinds = np.unique(unchanged_group), np.unique(changed_group)
    groups = np.union1d(*kinds)
    if min(kind.size for kind in kinds) < 2 or groups.size < 3:
        return
    table, is_met = wins(unchanged, changed), changed_group[:, None] != unchanged_group[None]
    expected = float(table[is_met].mean())
    left = [
        table[is_met & (changed_group != each)[:, None] & (unchanged_group != each)[None]].mean()
        for each in groups
    ]
    count = groups.size
    variance = (count - 1) / count * float(np.sum((np.array(left) - expected) ** 2))
    estimate = auc_interval(*pairs)
    assert estimate.is_by_photograph
    assert estimate.auc == pytest.approx(expected, abs=1e-12)
    if 0 < expected < 1 and variance > 1e-9:
        assert estimate.err == pytest.approx(sqrt(variance), rel=1e-9)
        half = float(stdtrit(min(kind.size for kind in kinds) - 1, 0.975)) * sqrt(variance)
        logit = log(expected / (1 - expected)) - half / (expected * (1 - expected))
        assert estimate.low == pytest.approx(1 / (1 + np.exp(-logit)), rel=1e-6, abs=1e-12)


def test_of_two_photographs_the_variance_is_that_of_their_two_comparisons() -> None:
    # Changed 4, 6 and unchanged 5, 1 of the one photograph, changed 2, 0 and unchanged 3, 5 of the
    # other: across, 3 of 4 (4 > 3; 6 > 3, 5) and 1 of 4 (2 > 1).
    unchanged, changed = np.array([5.0, 1.0, 3.0, 5.0]), np.array([4.0, 6.0, 2.0, 0.0])
    photographs = np.array([1, 1, 2, 2])
    estimate = auc_interval(unchanged, changed, photographs, photographs)
    assert estimate.auc == pytest.approx((3 + 1) / 8)
    # Of two equally large parts 3/4 and 1/4 the mean has the standard error |3/4 - 1/4| / 2.
    assert estimate.err == pytest.approx(0.25)
    assert estimate.is_by_photograph
    # With one degree of freedom t is tan(0.475 pi).
    assert estimate.high == pytest.approx(1 / (1 + exp(-0.25 * tan(0.475 * pi) / 0.25)), rel=1e-6)


@given(scored())
@settings(max_examples=40)
def test_any_rising_transform_of_scores_changes_nothing(pairs: Scored) -> None:
    unchanged, changed, *groups = pairs
    rising = (np.exp(unchanged) + 7, np.exp(changed) + 7)
    assert numbers(auc_interval(*rising, *groups)) == numbers(auc_interval(*pairs))


@given(scored(), st.randoms())
@settings(max_examples=40)
def test_the_order_of_pairs_and_the_names_of_photographs_do_not_matter(
    pairs: Scored, random: Random
) -> None:
    unchanged, changed, unchanged_group, changed_group = pairs
    shuffled = np.argsort([random.random() for _ in unchanged])
    other = auc_interval(
        unchanged[shuffled], changed, 90 - 7 * unchanged_group[shuffled], 90 - 7 * changed_group
    )
    assert numbers(other) == pytest.approx(numbers(auc_interval(*pairs)), rel=1e-9, abs=1e-12)


@given(scored())
@settings(max_examples=40)
def test_swapped_roles_give_the_rest_to_one(pairs: Scored) -> None:
    unchanged, changed, unchanged_group, changed_group = pairs
    one, other = (
        auc_interval(*pairs),
        auc_interval(changed, unchanged, changed_group, unchanged_group),
    )
    assert [one.auc, one.low, one.high, one.err] == pytest.approx(
        [1 - other.auc, 1 - other.high, 1 - other.low, other.err], rel=1e-6, abs=1e-9
    )


@given(scored(), st.integers(2, 4))
@settings(max_examples=40)
def test_copies_of_pairs_make_no_interval_narrower(pairs: Scored, copies: int) -> None:
    estimate = auc_interval(*pairs)
    again = auc_interval(*(np.tile(each, copies) for each in pairs))  # type: ignore[arg-type]
    if estimate.is_by_photograph:
        assert numbers(again) == pytest.approx(numbers(estimate), rel=1e-6, abs=1e-9)


@pytest.mark.slow
@given(scored())
def test_the_interval_holds_the_estimate_and_is_no_point(pairs: Scored) -> None:
    estimate = auc_interval(*pairs)
    assert 0 <= estimate.low <= estimate.auc <= estimate.high <= 1
    assert estimate.err > 0
    assert estimate.low < estimate.high


def test_where_all_is_found_the_interval_is_that_of_so_many_photographs() -> None:
    photographs = np.repeat(np.arange(10), 5)
    found = auc_interval(np.zeros(50), np.ones(50), photographs, photographs)
    # A rate of 0.025^(1/10) is found ten times of ten with a chance of 2.5 %.
    assert (found.auc, found.high) == (1.0, 1.0)
    assert found.low == pytest.approx(0.025 ** (1 / 10))
    missed = auc_interval(np.ones(50), np.zeros(50), photographs, photographs)
    assert (missed.auc, missed.low) == (0.0, 0.0)
    assert missed.high == pytest.approx(1 - 0.025 ** (1 / 10))
    pairs = one_photograph(np.zeros(8), np.ones(30))
    assert pairs.low == pytest.approx(0.025 ** (1 / 8))


def test_a_detector_that_says_the_same_of_all_pairs_is_no_better_than_chance() -> None:
    photographs = np.arange(6)
    estimate = auc_interval(np.ones(6), np.ones(6), photographs, photographs)
    assert estimate.auc == 0.5
    assert estimate.low == pytest.approx(0.118, abs=5e-4)  # Clopper and Pearson, 3 of 6
    assert estimate.high == pytest.approx(0.882, abs=5e-4)


def test_one_pair_of_a_kind_says_next_to_nothing() -> None:
    estimate = one_photograph(np.array([0.0]), np.array([1.0, -1.0]))
    # Half of one: near 0, beta(1/2, 3/2) has the distribution 4 sqrt(x) / pi.
    least = (0.025 * pi / 4) ** 2
    assert (estimate.low, estimate.high) == pytest.approx((least, 1 - least), abs=1e-6)


def test_photographs_that_differ_do_not_raise_the_auc_of_a_threshold_for_all() -> None:
    # Each photograph's changed pair is just above its unchanged one: perfect within, but a
    # threshold for all photographs does no better than chance.
    levels = np.arange(8.0)
    estimate = auc_interval(levels, levels + 0.5, levels.astype(int), levels.astype(int))
    assert estimate.auc == 0.5
    assert estimate.auc_all_pairs == (28 + 8) / 64


@pytest.mark.parametrize("auc", [0.6, 0.9])
def test_of_binormal_scores_it_is_the_closed_form(auc: float) -> None:
    d_prime = sqrt(2) * float(ndtri(auc))
    pairs = binormal(np.random.default_rng(5), d_prime, photographs=400, pairs=5)
    estimate = auc_interval(*pairs)
    # 3.29 standard errors: 999 of 1000.
    assert estimate.auc == pytest.approx(auc, abs=3.29 * estimate.err)
    assert estimate.err < 0.015


@pytest.mark.slow
def test_95_of_100_intervals_over_photographs_hold_the_truth() -> None:
    # Of 300 intervals that hold it at a rate of 94 to 96 %, 269 to 298 do, 999 times of 1000. Those
    # of independent pairs are half as wide as they should be: of a normal estimate 200.
    rng = np.random.default_rng(11)
    truth, held, of_pairs = 0.8, 0, 0
    for _ in range(300):
        pairs = binormal(rng, sqrt(2) * float(ndtri(truth)), photographs=20, pairs=40, share=0.7)
        estimate, alone = auc_interval(*pairs), one_photograph(*pairs[:2])
        held += estimate.low <= truth <= estimate.high
        of_pairs += alone.low <= truth <= alone.high
    assert 269 <= held <= 298
    assert of_pairs < 220


def test_auc_and_d_prime_are_each_others_inverse() -> None:
    assert float(d_prime_of_auc(0.5)) == 0.0
    assert float(d_prime_of_auc(0.8413447460685429)) == pytest.approx(sqrt(2))  # Phi(1)
    assert d_prime_of_auc(auc_of(np.array([0.3, 2.0, 5.0]))) == pytest.approx([0.3, 2.0, 5.0])
    assert np.isposinf(d_prime_of_auc(1.0))


@pytest.mark.parametrize(
    ("unchanged", "changed", "group", "says"),
    [
        ([], [1.0], [1], "row of scores"),
        ([[0.0]], [1.0], [1], "row of scores"),
        ([np.nan], [1.0], [1], "1 scores that are not finite"),
        ([0.0], [np.inf], [1], "1 scores that are not finite"),
        ([0.0], [1.0], [1, 2], "photographs of"),
    ],
)
def test_scores_that_are_none_are_refused(
    unchanged: list[float], changed: list[float], group: list[int], says: str
) -> None:
    groups = np.zeros(np.shape(unchanged), np.int64), np.array(group)
    with pytest.raises(ValueError, match=says):
        auc_interval(np.array(unchanged), np.array(changed), *groups)


def test_an_interval_far_out_in_the_logit_does_not_overflow() -> None:
    wide = share_interval(0.5, 0.2, 1, 2)
    assert 0 <= wide.low < wide.high <= 1
    assert share_interval(0.5, 1e4, 1, 2).low == pytest.approx(0.0, abs=1e-300)
