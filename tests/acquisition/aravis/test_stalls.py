"""When the driver says that a stream has stalled, on a clock of the test's own."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from acquisition.aravis.camera import AravisCamera
from acquisition.devices import DeviceInfo, Frame, StreamStatistics
from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceTimeoutError,
    StreamInterruptedError,
)
from tests.acquisition.aravis_bench import camera_config
from tests.acquisition.fakes import SETTINGS, FakeClock, frame


class QueueOfFrames:
    """A stream whose waits take as long as the script says; a frame comes at once."""

    def __init__(self, clock: FakeClock, script: Iterator[Frame | float]) -> None:
        self._clock = clock
        self._script = script

    def start(self) -> None:
        """Nothing waits to be dropped."""

    def pop(self, timeout_s: float) -> Frame | None:
        item = next(self._script, timeout_s)
        if isinstance(item, Frame):
            return item
        self._clock.now_s += max(item, timeout_s)
        return None

    def restart_if_deaf(self) -> bool:
        return False


def connection_to(stream: QueueOfFrames) -> Any:
    return SimpleNamespace(
        info=DeviceInfo(vendor="", model="", serial_number="1", firmware="", driver="aravis"),
        settings=SETTINGS,
        exposure_limits_us=(20.0, 1e6),
        warnings=(),
        is_lost=False,
        stream=stream,
    )


def streaming(*script: Frame | float) -> tuple[AravisCamera, FakeClock]:
    clock = FakeClock()
    connection = connection_to(QueueOfFrames(clock, iter(script)))
    camera = AravisCamera(connection, camera_config("127.0.0.1"), clock=clock)
    camera.start()
    return camera, clock


def test_a_camera_that_sends_nothing_has_stalled_after_a_second() -> None:
    camera, clock = streaming(frame(10, 1))
    camera.next_frame(3.0)
    began_s = clock.now_s
    with pytest.raises(StreamInterruptedError):
        camera.next_frame(3.0)
    assert clock.now_s - began_s == pytest.approx(1.0)


def test_short_waits_add_up_to_a_stall() -> None:
    camera, _ = streaming()
    for _ in range(3):
        with pytest.raises(DeviceTimeoutError):
            camera.next_frame(0.25)
    with pytest.raises(StreamInterruptedError):
        camera.next_frame(0.26)


def test_a_program_that_is_not_scheduled_for_seconds_has_no_stalled_camera() -> None:
    camera, clock = streaming(5.0, frame(10, 1), 5.0, 5.0, frame(10, 2))
    assert camera.next_frame(30.0).frame_id == 1
    assert camera.next_frame(30.0).frame_id == 2
    assert clock.now_s == 100.0 + 15.0


def test_the_counts_are_told_while_a_lost_camera_is_being_closed() -> None:
    lost = connection_to(QueueOfFrames(FakeClock(), iter(())))
    counted = StreamStatistics(
        complete_frames=7, incomplete_frames=1, resent_packets=3, missing_packets=2
    )
    told: list[StreamStatistics] = []

    def statistics() -> StreamStatistics:
        if lost.is_closed:
            raise DeviceDisconnectedError("the connection to the camera is closed")
        return counted

    def close() -> None:
        lost.is_closed = True
        told.append(camera.statistics())  # as another thread does: this may take 10 s

    lost.is_closed, lost.is_lost = False, True
    lost.stream.statistics, lost.close = statistics, close
    camera = AravisCamera(
        lost,
        camera_config("127.0.0.1"),
        connect=lambda _: connection_to(QueueOfFrames(FakeClock(), iter(()))),
        clock=FakeClock(),
    )
    camera.start()
    assert told == [counted]
