import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.sharpness.verdict import Figure, largest, median_of, ratio, smallest

VALUES = st.lists(st.tuples(st.floats(0.01, 1.0), st.floats(0.0, 0.2)), min_size=1, max_size=12)


def figures(pairs: list[tuple[float, float]]) -> list[Figure]:
    return [Figure(value=value, err=err, where=f"{k}") for k, (value, err) in enumerate(pairs)]


@given(pairs=VALUES)
def test_the_smallest_is_within_its_interval_and_below_the_largest(
    pairs: list[tuple[float, float]],
) -> None:
    low, high = smallest(figures(pairs)), largest(figures(pairs))
    assert low.low <= low.value == min(value for value, _ in pairs)
    assert high.value == max(value for value, _ in pairs) <= high.high
    assert low.low <= low.high
    assert high.low <= high.high


@given(pairs=VALUES)
def test_one_more_edge_never_raises_the_lower_end_of_the_smallest(
    pairs: list[tuple[float, float]],
) -> None:
    fewer = pairs[:-1] or pairs
    assert smallest(figures(pairs)).low <= smallest(figures(fewer)).low


def test_a_single_figure_is_its_own_smallest_and_largest() -> None:
    one = Figure(value=0.3, err=0.01, where="here")
    # The 97.5 % point of a unit normal.
    assert one.low == pytest.approx(0.3 - 0.0195996, abs=1e-7)
    for found in (smallest([one]), largest([one])):
        assert (found.low, found.high, found.where) == pytest.approx((one.low, one.high, "here"))


@pytest.mark.parametrize("count", [1, 8, 60])
def test_the_interval_of_the_smallest_holds_the_true_one_in_95_percent(count: int) -> None:
    rng = np.random.default_rng(count)
    held = 0
    for _ in range(600):
        truth = rng.uniform(0.2, 0.3, count)
        errs = rng.uniform(0.005, 0.03, count)
        seen = rng.normal(truth, errs)
        found = smallest([Figure(value=v, err=e) for v, e in zip(seen, errs, strict=True)])
        held += found.low <= truth.min() <= found.high
    # Binomial: 600 trials at 95 % give 543 or more in 999 of 1000.
    assert held >= 543


def test_the_median_of_few_has_their_own_errors_and_of_many_their_scatter() -> None:
    two = median_of([Figure(value=0.2, err=0.03), Figure(value=0.4, err=0.04)], "zone")
    # A mean of two: sqrt(0.03^2 + 0.04^2) / 2.
    assert (two.value, two.err) == pytest.approx((0.3, 0.025))
    assert two.where == "zone (2 edges)"
    values = [0.1, 0.2, 0.3, 0.4, 0.5]
    scattered = median_of([Figure(value=v, err=1e-6) for v in values], "zone")
    # Median absolute deviation 0.1: 1.2533 * 0.1 / 0.67449 / sqrt(5).
    assert scattered.err == pytest.approx(0.083098, rel=1e-4)


def test_a_shift_without_its_sign_includes_0_where_its_interval_does() -> None:
    crossing = Figure(value=-0.1, err=0.1).modulus()
    assert (crossing.value, crossing.low) == (0.1, 0.0)
    assert crossing.high == pytest.approx(0.1 + 0.195996, abs=1e-6)
    clear = Figure(value=-0.5, err=0.1).modulus()
    assert (clear.low, clear.high) == pytest.approx((0.304004, 0.695996), abs=1e-6)


def test_a_ratio_covers_its_truth() -> None:
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(600):
        above, below = rng.normal([0.15, 0.25], [0.01, 0.012])
        found = ratio(Figure(value=above, err=0.01), Figure(value=below, err=0.012))
        held += found.low <= 0.6 <= found.high
    assert held >= 543


@pytest.mark.parametrize("function", [smallest, largest])
def test_of_nothing_there_is_no_extreme(function: object) -> None:
    with pytest.raises(ValueError, match="no figures"):
        function([])  # type: ignore[operator]
