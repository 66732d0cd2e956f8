import numpy as np
import pytest
from hypothesis import given, strategies as st

from acquisition.focus.live import FocusReading, FocusTrace

RAMP_UP = np.linspace(1.0, 2.0, 30)


def followed(values: np.ndarray, trace: FocusTrace | None = None) -> list[FocusReading]:
    trace = trace or FocusTrace()
    return [trace.add(float(value)) for value in values]


def test_through_the_peak_it_rises_passes_and_comes_back() -> None:
    there = followed(np.concatenate([RAMP_UP, RAMP_UP[::-1][1:20]]))
    assert there[20].trend == "rising"
    assert not any(reading.is_past_peak for reading in there[:31])
    assert there[-1].trend == "falling"
    assert there[-1].is_past_peak
    assert there[-1].peak == pytest.approx(2.0, abs=0.04)  # median of three
    trace = FocusTrace()
    followed(np.concatenate([RAMP_UP, RAMP_UP[::-1][1:20]]), trace)
    back = followed(RAMP_UP[11:], trace)
    assert not back[-1].is_past_peak
    assert back[-1].percent_of_peak == pytest.approx(100.0, abs=3.0)


def test_falling_from_the_start_is_the_wrong_way_but_no_peak_was_passed() -> None:
    readings = followed(RAMP_UP[::-1])
    assert readings[-1].trend == "falling"
    assert not any(reading.is_past_peak for reading in readings)


def test_noise_neither_has_a_trend_nor_passes_a_peak() -> None:
    rng = np.random.default_rng(3)
    readings = followed(1 + 0.05 * rng.standard_normal(400))
    assert np.mean([reading.trend == "steady" for reading in readings]) > 0.97
    assert np.mean([reading.is_past_peak for reading in readings]) < 0.02
    assert readings[-1].noise == pytest.approx(0.05, rel=0.2)


def test_a_single_outlier_is_not_held_as_the_peak() -> None:
    readings = followed(np.array([1.0, 1.0, 1.0, 9.0, 1.0, 1.0, 1.0]))
    assert readings[-1].peak == 1.0


@given(st.lists(st.floats(0.0, 1e6), min_size=1, max_size=60))
def test_the_peak_never_falls_and_is_never_below_the_value(values: list[float]) -> None:
    readings = followed(np.array(values))
    peaks = [reading.peak for reading in readings]
    assert peaks == sorted(peaks)
    assert all(reading.value <= reading.peak for reading in readings)
    assert all(0.0 <= reading.percent_of_peak <= 100.0 + 1e-9 for reading in readings)


def test_reset_forgets_the_peak() -> None:
    trace = FocusTrace()
    followed(RAMP_UP, trace)
    trace.reset()
    assert trace.add(0.5).peak == 0.5


def test_what_is_no_number_is_refused() -> None:
    with pytest.raises(ValueError):
        FocusTrace().add(float("nan"))


@pytest.mark.parametrize("wrong", [{"smoothed": 2}, {"window": 3}, {"drop": 0.0}])
def test_settings_without_sense_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(ValueError):
        FocusTrace(**wrong)


def test_where_there_is_nothing_to_focus_on_there_is_no_trend_and_the_peak_stays() -> None:
    rng = np.random.default_rng(6)
    trace = FocusTrace()
    seen = followed(0.01 + rng.normal(0, 1e-5, 20), trace)
    empty = [trace.add(float(value), has_detail=False) for value in rng.normal(0, 1, 30)]
    assert not any(reading.has_detail for reading in empty[4:])
    assert {reading.percent_of_peak for reading in empty[4:]} == {0.0}
    assert {reading.trend for reading in empty[4:]} == {"steady"}
    back = followed(0.01 + rng.normal(0, 1e-5, 20), trace)
    assert back[-1].has_detail
    assert seen[-1].has_detail


def test_detail_at_the_limit_of_the_noise_does_not_come_and_go() -> None:
    rng = np.random.default_rng(7)
    trace = FocusTrace()
    shown = [
        trace.add(0.01, has_detail=number == 0 or bool(rng.random() < 0.7)).has_detail
        for number in range(300)
    ]
    assert np.mean(shown) > 0.95
