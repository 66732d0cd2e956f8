"""Turns that may be taken at once, and then at a steady rate."""

import pytest
from hypothesis import given, strategies as st

from standoff.console.serving.allowance import Allowance


class Clock:
    """Time that passes when the test says so."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def test_after_those_at_once_each_turn_takes_its_time() -> None:
    clock = Clock()
    allowance = Allowance(at_once=3, period_s=2.0, clock=clock)
    assert [allowance.take() for _ in range(5)] == [0.0, 0.0, 0.0, 2.0, 4.0]
    clock.now_s += 4.0
    assert allowance.wait_s == 2.0
    clock.now_s += 2.0
    assert allowance.wait_s == 0.0
    assert allowance.take() == 0.0
    assert not allowance.is_full


def test_a_rest_gives_back_no_more_than_there_was() -> None:
    clock = Clock()
    allowance = Allowance(at_once=2, period_s=1.0, clock=clock)
    allowance.take()
    clock.now_s += 1000.0
    assert allowance.is_full
    assert [allowance.take() for _ in range(3)] == [0.0, 0.0, 1.0]


@given(pauses_s=st.lists(st.floats(0, 3), min_size=1, max_size=40))
def test_in_any_time_no_more_are_taken_than_that_time_allows(pauses_s: list[float]) -> None:
    clock = Clock()
    begin_s = clock.now_s
    allowance = Allowance(at_once=5, period_s=1.0, clock=clock)
    taken = 0
    for pause_s in pauses_s:
        clock.now_s += pause_s
        if allowance.wait_s == 0:
            assert allowance.take() == pytest.approx(0, abs=1e-9)  # sums of pauses are rounded
            taken += 1
    assert taken <= 5 + (clock.now_s - begin_s) + 1e-9
