import math
from itertools import pairwise

import pytest
from hypothesis import given, strategies as st

from acquisition.capture.step import (
    bracket_exposures_us,
    flicker_fraction,
    next_exposure,
    without_flicker,
)

BLACK_DN, MAX_DN = 64.0, 4095.0
LIMITS_US = (50.0, 16000.0)


def bright(exposure_us: float, dn_per_us: float) -> float:
    return min(BLACK_DN + dn_per_us * exposure_us, MAX_DN)


@given(
    dn_per_us=st.floats(0.05, 50.0),
    start_us=st.floats(50.0, 16000.0),
    mains_hz=st.sampled_from([0.0, 50.0, 60.0]),
)
def test_a_linear_camera_is_well_exposed_within_eight_pictures(
    dn_per_us: float, start_us: float, mains_hz: float
) -> None:
    exposure_us = start_us
    for _ in range(8):
        step = next_exposure(
            exposure_us,
            bright(exposure_us, dn_per_us),
            black_level_dn=BLACK_DN,
            max_level_dn=MAX_DN,
            limits_us=LIMITS_US,
            mains_hz=mains_hz,
        )
        assert LIMITS_US[0] <= step.exposure_us <= LIMITS_US[1]
        if step.is_settled:
            break
        exposure_us = step.exposure_us
    assert step.is_settled
    light = (bright(exposure_us, dn_per_us) - BLACK_DN) / (MAX_DN - BLACK_DN)
    # Within 10 % of the exposure for 70 %, or there is a reason.
    assert bool(step.limited_by) == (not 0.7 / 1.1 <= light <= 0.7 / 0.9)
    at_a_limit = exposure_us <= LIMITS_US[0] * 1.12 or exposure_us >= LIMITS_US[1] / 1.12
    if mains_hz == 0 and not at_a_limit:
        assert 0.6 <= light <= 0.8
    assert light < 0.8 or exposure_us <= LIMITS_US[0] * 1.12


def test_a_saturated_picture_says_only_shorter() -> None:
    step = next_exposure(
        8000.0, MAX_DN, black_level_dn=BLACK_DN, max_level_dn=MAX_DN, limits_us=LIMITS_US
    )
    assert (step.exposure_us, step.is_settled) == (2000.0, False)


@pytest.mark.parametrize(
    ("dn_per_us", "mains_hz", "limited_by"),
    [
        (0.25, 0.0, ()),  # 11.3 ms
        (0.25, 50.0, ("flicker",)),  # 10 ms of 11.3
        (0.14, 50.0, ("longest", "flicker")),  # 16 of 20 ms, then 10
        (0.14, 0.0, ("longest",)),
        (0.282, 50.0, ()),  # 10 of 10.006 ms
        (80.0, 50.0, ("shortest",)),  # 35 us
        (500.0, 50.0, ("shortest",)),  # saturated at 50 us
        (0.0, 0.0, ("longest",)),
    ],
)
def test_what_keeps_the_exposure_from_seventy_per_cent_is_said(
    dn_per_us: float, mains_hz: float, limited_by: tuple[str, ...]
) -> None:
    exposure_us = 2000.0
    for _ in range(8):
        step = next_exposure(
            exposure_us,
            bright(exposure_us, dn_per_us),
            black_level_dn=BLACK_DN,
            max_level_dn=MAX_DN,
            limits_us=LIMITS_US,
            mains_hz=mains_hz,
        )
        exposure_us = step.exposure_us
    assert step.is_settled
    assert step.limited_by == limited_by


@pytest.mark.parametrize("limits_us", [(0.0, 1.0), (2.0, 1.0), (math.nan, 1.0)])
def test_limits_out_of_order_are_refused(limits_us: tuple[float, float]) -> None:
    with pytest.raises(ValueError):
        next_exposure(1.0, 1.0, black_level_dn=0, max_level_dn=9, limits_us=limits_us)


@given(exposure_us=st.floats(1.0, 1e6), mains_hz=st.sampled_from([50.0, 60.0]))
def test_whole_periods_keep_no_flicker(exposure_us: float, mains_hz: float) -> None:
    cut_us = without_flicker(exposure_us, mains_hz)
    assert cut_us <= exposure_us * (1 + 1e-9)
    if cut_us >= 0.5e6 / mains_hz:
        assert flicker_fraction(cut_us, mains_hz) < 1e-9


def test_the_flicker_that_is_left_is_a_sinc() -> None:
    assert flicker_fraction(5000.0, 50) == pytest.approx(2 / math.pi)  # half a period
    assert flicker_fraction(1e-3, 50) == pytest.approx(1.0)
    assert flicker_fraction(9000.0, 0) == 0.0


def test_longer_exposures_of_a_bracket_are_whole_periods_of_the_flicker() -> None:
    assert bracket_exposures_us(9000.0, (1.0, 4.0, 16.0), 50) == (9000.0, 30_000.0, 140_000.0)
    assert bracket_exposures_us(500.0, (1.0, 8.0), 50) == (500.0, 4000.0)
    assert bracket_exposures_us(9000.0, (1.0, 4.0, 16.0), 0) == (9000.0, 36_000.0, 144_000.0)


@given(st.floats(21.0, 1e6), st.floats(1.5, 32.0), st.integers(2, 12), st.sampled_from([0, 50, 60]))
def test_exposures_of_a_bracket_ascend(
    shortest_us: float, ratio: float, count: int, mains_hz: float
) -> None:
    exposures_us = bracket_exposures_us(
        shortest_us, [ratio**number for number in range(count)], mains_hz
    )
    assert exposures_us[0] == shortest_us
    assert all(one < other for one, other in pairwise(exposures_us))
