"""Sharpness while one focuses."""

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, strategies as st

from acquisition.devices import Frame
from acquisition.errors import DeviceError, DeviceTimeoutError, StreamInterruptedError
from acquisition.focus._live import (
    FocusMeter,
    FocusOptions,
    FocusReading,
    FocusTrace,
    newest_frames,
)
from acquisition.focus._measures import Region, focus_value
from tests.acquisition.fakes import ScriptedCamera, frame

BLACK_DN = 64.0


def noisy(
    rng: np.random.Generator, sigma_dn: float
) -> np.ndarray[tuple[int, int], np.dtype[np.uint16]]:
    """A vertical edge of 400 and 2000 DN with white noise."""
    clean = np.where(np.arange(200) < 100, 400.0, 2000.0) * np.ones((160, 1))
    return np.rint(clean + sigma_dn * rng.standard_normal(clean.shape)).astype(np.uint16)


def test_the_first_frame_gives_no_value_as_its_noise_is_not_known() -> None:
    meter = FocusMeter(FocusOptions())
    frame = noisy(np.random.default_rng(1), 20.0)
    assert meter.add(frame, BLACK_DN) is None
    assert meter.add(frame, BLACK_DN) is not None


def test_the_noise_of_single_frames_is_taken_out() -> None:
    rng = np.random.default_rng(2)
    clean = focus_value(noisy(rng, 0.0), black_level_dn=BLACK_DN)
    meter = FocusMeter(FocusOptions())
    values = [meter.add(noisy(rng, 20.0), BLACK_DN) for _ in range(9)]
    raw = focus_value(noisy(rng, 20.0), black_level_dn=BLACK_DN)
    # 4 v / mean((I - b)^2) is 1600 / 1.9e6 = 8e-4 of noise in 6.7e-3; 32 000 px leave 1 % of it.
    assert raw == pytest.approx(clean + 4 * 400 / 1.93e6, rel=0.02)
    assert values[-1] == pytest.approx(clean, rel=0.01)


def test_a_known_noise_is_used_from_the_first_frame_on() -> None:
    meter = FocusMeter(FocusOptions(noise=lambda level_dn: 400.0))
    frame = noisy(np.random.default_rng(3), 20.0)
    expected = focus_value(frame, black_level_dn=BLACK_DN, noise_variance_dn2=400.0)
    assert meter.add(frame, BLACK_DN) == expected


def test_only_the_region_is_looked_at() -> None:
    flat = Region(x_px=10, y_px=20, width_px=60, height_px=50)
    meter = FocusMeter(FocusOptions(region=flat, noise=lambda level_dn: 0.0))
    assert meter.add(noisy(np.random.default_rng(4), 0.0), BLACK_DN) == 0.0


def test_frames_that_change_their_size_are_refused() -> None:
    meter = FocusMeter(FocusOptions())
    frame = noisy(np.random.default_rng(5), 1.0)
    meter.add(frame, BLACK_DN)
    with pytest.raises(ValueError):
        meter.add(frame[:-2], BLACK_DN)


NONE_WAITS = DeviceTimeoutError("no frame within 0.0 s")


class BreakingCamera(ScriptedCamera):
    """Streams no more once its stream broke off, until it is started again."""

    def __init__(self, script: Iterable[Frame | BaseException]) -> None:
        super().__init__(script)

    def next_frame(self, timeout_s: float) -> Frame:
        try:
            return super().next_frame(timeout_s)
        except StreamInterruptedError:
            self.is_streaming = False
            raise


def ids_of(camera: ScriptedCamera, count: int) -> list[int]:
    frames = newest_frames(camera)
    found = [next(frames).frame_id for _ in range(count)]
    frames.close()
    assert not camera.is_streaming
    return found


def test_of_frames_that_wait_the_newest_is_given() -> None:
    waiting = [frame(1000, number) for number in (1, 2, 3)]
    camera = BreakingCamera([*waiting, NONE_WAITS, frame(1000, 4), NONE_WAITS])
    assert ids_of(camera, 2) == [3, 4]
    assert camera.starts == 1


def test_an_incomplete_frame_is_never_the_newest() -> None:
    torn = frame(1000, 2, is_complete=False)
    lone = frame(1000, 3, is_complete=False)
    camera = BreakingCamera(
        [frame(1000, 1), torn, NONE_WAITS, lone, NONE_WAITS, frame(1000, 4), NONE_WAITS]
    )
    assert ids_of(camera, 2) == [1, 4]


def test_a_stream_that_broke_off_is_begun_once_more() -> None:
    broken = StreamInterruptedError("the camera restarted")
    camera = BreakingCamera([broken, frame(1000, 1), NONE_WAITS, frame(1000, 2), NONE_WAITS])
    assert ids_of(camera, 2) == [1, 2]
    assert camera.starts == 2


def test_a_stream_that_breaks_off_behind_a_frame_still_gives_it() -> None:
    broken = StreamInterruptedError("the camera restarted")
    camera = BreakingCamera([frame(1000, 1), broken, frame(1000, 2), NONE_WAITS])
    assert ids_of(camera, 2) == [1, 2]
    assert camera.starts == 2


def test_a_stream_that_breaks_off_again_at_once_is_an_error() -> None:
    broken = StreamInterruptedError("the camera restarted")
    camera = BreakingCamera([broken, broken])
    with pytest.raises(DeviceError):
        next(newest_frames(camera))
    assert not camera.is_streaming


def test_a_camera_faster_than_the_loop_does_not_hold_it() -> None:
    # 64 frames beyond the first are looked at, as many as a driver may hold.
    camera = BreakingCamera(frame(1000, number) for number in range(1, 1000))
    assert ids_of(camera, 2) == [65, 130]


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


@pytest.mark.slow
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
