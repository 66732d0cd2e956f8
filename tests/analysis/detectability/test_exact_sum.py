import math
import random

import numpy as np
import pytest
from hypothesis import given, strategies as st

from analysis.detectability._sweep import ExactSum, on_own_grid

NUMBERS = st.lists(st.floats(-1e60, 1e60, allow_subnormal=False), min_size=1, max_size=12)


@given(NUMBERS, st.randoms(use_true_random=False))
def test_a_sum_is_the_nearest_number_in_any_order_and_of_sums_of_parts(
    numbers: list[float], rng: random.Random
) -> None:
    """`math.fsum` is the judge."""
    shuffled = rng.sample(numbers, len(numbers))
    cut = rng.randrange(len(numbers) + 1)
    whole = ExactSum(np.array([one]) for one in shuffled)
    parts = [ExactSum(np.array([one]) for one in some) for some in (numbers[:cut], numbers[cut:])]
    of_parts = ExactSum(term for part in parts for term in part.terms())
    assert whole.rounded()[0] == of_parts.rounded()[0] == math.fsum(numbers)


@pytest.mark.parametrize(
    "numbers",
    [
        (1.0, 2.0**-53, 2.0**-110),  # above the middle between two numbers
        (1.0, 2.0**-53, -(2.0**-110)),
        (1.0, 2.0**-53),  # in the middle: the even one
        (1.0 + 2.0**-52, 2.0**-53),
        (1.0, -(2.0**-54), -(2.0**-120)),
        (1e300, 1.0, -1e300),
        (0.0, 0.0),
    ],
)
def test_halves_of_a_last_bit_go_to_where_the_rest_says(numbers: tuple[float, ...]) -> None:
    assert ExactSum(np.array([one]) for one in numbers).rounded()[0] == math.fsum(numbers)


def test_elements_are_summed_apart() -> None:
    rows = np.random.default_rng(3).normal(size=(50, 4, 3)) * 10.0 ** np.arange(3)
    found = ExactSum(rows).rounded()
    assert found.tolist() == [
        [math.fsum(rows[:, y, x].tolist()) for x in range(3)] for y in range(4)
    ]


def test_sums_on_grids_take_two_terms_and_a_last_bit_of_the_largest() -> None:
    rng = np.random.default_rng(4)
    rows = rng.normal(size=(2000, 1, 9, 9)) * np.logspace(-6, 0, 2000)[:, None, None, None]
    gridded = [on_own_grid(row) for row in rows]
    for row, rounded in zip(rows, gridded, strict=True):
        assert np.abs(rounded - row).max() <= 2.0**-51 * np.abs(row).max()
    assert len(ExactSum(gridded).terms()) == 2
    assert not on_own_grid(np.zeros((2, 3, 3))).any()
