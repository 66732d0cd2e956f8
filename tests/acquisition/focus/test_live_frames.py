from collections.abc import Iterable

import pytest

from acquisition.devices import Frame
from acquisition.errors import DeviceError, DeviceTimeoutError, StreamInterruptedError
from acquisition.focus.live import newest_frames
from tests.acquisition.fakes import ScriptedCamera, frame

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
