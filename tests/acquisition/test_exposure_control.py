from collections.abc import Iterable
from itertools import count

import pytest

from acquisition.devices import Frame
from acquisition.errors import CameraFeatureError, CaptureError, StreamInterruptedError
from acquisition.exposure_control import ExposedFrames, ExposureControl
from tests.acquisition.fakes import SETTINGS, ScriptedCamera, frame
from tests.acquisition.watched_camera import WatchedCamera
from tests.hil_mocks.benches import homed_bench

FRAMES = 3
SHORTEST_US = 9000.0


def controlled(
    target: str, delay: tuple[int, int], seed: int = 0, *, is_told: bool = False
) -> tuple[WatchedCamera, ExposureControl]:
    """A camera over a target; a pixel of 60 um sees the whole of the step tablet's width."""
    bench = homed_bench(camera__exposure_us=SHORTEST_US, optics__pixel_pitch_um=60.0)
    bench.place(target)
    camera = WatchedCamera(bench.camera, delay, seed, is_told=is_told)
    return camera, ExposureControl(camera, SHORTEST_US, lambda: bench.clock.now_s)


def stale(camera: WatchedCamera, taken: Iterable[ExposedFrames]) -> int:
    """Frames of averages that had another exposure in truth."""
    return sum(
        camera.true_us[image.tobytes()] != one.exposure_us
        for one in taken
        for image in one.raw_frames
    )


@pytest.mark.slow
@pytest.mark.parametrize("target", ["step tablet", "edge"])
@pytest.mark.parametrize("ratio", [2.0, 8.0])
def test_no_stale_frame_enters_a_bracket_however_late_the_camera_is(
    target: str, ratio: float
) -> None:
    camera, control = controlled(target, (0, 9), seed=5)
    exposures_us = [SHORTEST_US * ratio**number for number in range(3)]
    for _ in range(8):
        taken = control.bracket(FRAMES, exposures_us, keep_frames=True)
        assert [one.exposure_us for one in taken] == exposures_us
        assert [len(one.raw_frames) for one in taken] == [FRAMES] * 3
        assert stale(camera, taken) == 0
    assert len(set(camera.true_us.values())) == 3


def test_a_camera_that_is_later_than_any_average_is_long_is_found_out() -> None:
    camera, control = controlled("step tablet", (20, 20))
    exposures_us = [SHORTEST_US, 4 * SHORTEST_US, 16 * SHORTEST_US]
    for _ in range(2):
        assert stale(camera, control.bracket(FRAMES, exposures_us, keep_frames=True)) == 0
    assert control.frames_late >= 20


def test_frames_that_state_their_exposure_are_believed_even_in_the_dark() -> None:
    camera, control = controlled("dark", (7, 7), is_told=True)
    taken = control.bracket(FRAMES, [SHORTEST_US, 8 * SHORTEST_US], keep_frames=True)
    assert stale(camera, taken) == 0
    # One late frame is the one that every average leaves out.
    assert [one.averaged.stale_frames for one in taken] == [0, 6]


def test_in_the_dark_as_many_frames_are_left_out_as_the_camera_needed() -> None:
    _, control = controlled("dark", (2, 2))
    taken = control.bracket(FRAMES, [SHORTEST_US, 8 * SHORTEST_US, 64 * SHORTEST_US])
    assert [one.averaged.stale_frames for one in taken] == [3, 3, 3]


def test_no_stale_frame_enters_a_ladder_of_single_exposures() -> None:
    camera, control = controlled("edge", (0, 5), seed=2)
    ladder_us = [SHORTEST_US * factor for factor in (1.0, 0.25, 0.5, 0.05, 1.0)]
    taken = [control.average(FRAMES, one, keep_frames=True) for one in ladder_us]
    assert stale(camera, taken) == 0


def test_a_change_before_an_interrupted_average_is_not_forgotten(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    camera, control = controlled("edge", (4, 4))
    with monkeypatch.context() as cut:
        cut.setattr(camera, "next_frame", interrupted)
        with pytest.raises(StreamInterruptedError):
            control.average(FRAMES, SHORTEST_US / 4)
    assert stale(camera, [control.average(FRAMES, SHORTEST_US / 4, keep_frames=True)]) == 0


def interrupted(timeout_s: float) -> Frame:
    raise StreamInterruptedError(f"the cable was pulled before {timeout_s} s")


def test_an_exposure_that_is_set_already_costs_no_frame() -> None:
    camera, control = controlled("edge", (0, 0))
    control.average(FRAMES, SHORTEST_US)
    camera.true_us.clear()
    assert control.average(FRAMES, SHORTEST_US).averaged.stale_frames == 0
    assert len(camera.true_us) == FRAMES + 1


def test_an_exposure_that_was_set_before_may_not_be_followed_yet() -> None:
    camera, control = controlled("edge", (3, 3))
    camera.set_exposure_us(SHORTEST_US / 8)
    assert stale(camera, [control.average(FRAMES, SHORTEST_US / 8, keep_frames=True)]) == 0
    camera.set_exposure_us(SHORTEST_US)
    control.settle(SHORTEST_US)
    camera.true_us.clear()
    assert stale(camera, [control.average(FRAMES, SHORTEST_US, keep_frames=True)]) == 0
    assert len(camera.true_us) == FRAMES + 1


def test_a_camera_that_does_not_follow_is_an_error() -> None:
    _, control = controlled("edge", (200, 200))
    with pytest.raises(CaptureError):
        control.bracket(FRAMES, [SHORTEST_US, 4 * SHORTEST_US])


def test_light_that_flickers_spoils_a_bracket_but_no_single_exposure() -> None:
    flicker = (frame(500 if number % 2 else 1500, number) for number in count(1))
    camera = ScriptedCamera(flicker)
    control = ExposureControl(camera, SETTINGS.exposure_us, camera.clock)
    averaged = control.average(FRAMES, 4 * SETTINGS.exposure_us).averaged
    assert (averaged.frames_used, averaged.max_dn, averaged.min_dn) == (FRAMES, 1500, 500)
    with pytest.raises(CaptureError):
        control.bracket(FRAMES, [SETTINGS.exposure_us, 4 * SETTINGS.exposure_us])


def test_a_camera_that_sets_another_exposure_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    camera, control = controlled("edge", (0, 0))
    set_us = camera.set_exposure_us
    monkeypatch.setattr(camera, "set_exposure_us", lambda asked: set_us(min(asked, 20_000.0)))
    with pytest.raises(CameraFeatureError) as refused:
        control.bracket(FRAMES, [SHORTEST_US, 8 * SHORTEST_US])
    assert refused.value.feature == "ExposureTime"
