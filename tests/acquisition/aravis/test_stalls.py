"""Streams that stall and exposures that come late."""

import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from acquisition.aravis._camera import AravisCamera
from acquisition.devices import DeviceInfo, Frame, StreamStatistics
from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceProtocolError,
    DeviceTimeoutError,
    StreamInterruptedError,
)
from acquisition.exposure_control import ExposureControl
from hil_mocks.gige import GigeFaults
from tests.acquisition.aravis_bench import camera_config, needs_aravis, opened
from tests.acquisition.fakes import SETTINGS, FakeClock, frame
from tests.hil_mocks.gige_bench import HEIGHT_MM, gige_bench


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


def losing_its_camera(
    connect: Callable[[Any], Any], reconnect_timeout_s: float
) -> tuple[AravisCamera, FakeClock]:
    lost = connection_to(QueueOfFrames(FakeClock(), iter(())))
    lost.is_lost, lost.close = True, lambda: None
    lost.stream.statistics = lambda: StreamStatistics(
        complete_frames=0, incomplete_frames=0, resent_packets=0, missing_packets=0
    )
    clock = FakeClock()
    config = camera_config("127.0.0.1", reconnect_timeout_s=reconnect_timeout_s)

    def pause(seconds_s: float) -> None:
        clock.now_s += seconds_s

    return AravisCamera(lost, config, connect=connect, clock=clock, sleep=pause), clock


def test_a_camera_whose_answers_are_wrong_while_it_starts_is_waited_for() -> None:
    tried: list[Any] = []

    def connect(config: Any) -> Any:
        tried.append(config)
        if len(tried) < 4:
            raise DeviceProtocolError("its description cannot be read (status 0x0000)")
        return connection_to(QueueOfFrames(FakeClock(), iter(())))

    camera, _ = losing_its_camera(connect, reconnect_timeout_s=30.0)
    camera.start()
    assert len(tried) == 4


def test_a_camera_whose_answers_stay_wrong_did_not_come_back() -> None:
    def connect(_: Any) -> Any:
        raise DeviceProtocolError("its description cannot be read (status 0x0000)")

    camera, clock = losing_its_camera(connect, reconnect_timeout_s=3.0)
    began_s = clock.now_s
    with pytest.raises(DeviceDisconnectedError, match=r"within 3 s \(its description .*0x0000\)"):
        camera.start()
    assert clock.now_s - began_s == pytest.approx(3.0, abs=1.0)


EXPOSURES_US = [500.0, 2000.0, 8000.0]
FRAMES = 3


@pytest.mark.slow
@needs_aravis
@pytest.mark.parametrize("delay", [0, 5])
def test_a_bracket_over_the_wire_has_only_frames_of_its_exposures(delay: int) -> None:
    with gige_bench() as bench, opened(bench, exposure_us=4000.0) as camera:
        bench.place("edge", 5.0)
        bench.camera.faults = GigeFaults(exposure_delay_frames=delay)
        control = ExposureControl(camera, 4000.0, time.monotonic)
        for _ in range(2):
            taken = control.bracket(FRAMES, EXPOSURES_US, keep_frames=True)
            for one in taken:
                expected = bench.truth.expected_image_dn(
                    "edge", 5.0, HEIGHT_MM, exposure_us=one.exposure_us
                )
                levels = [float(np.mean(image)) for image in one.raw_frames]
                assert len(levels) == FRAMES
                # The next exposure differs by a factor of 4, noise of 6144 pixels by .3 DN.
                assert levels == pytest.approx([float(expected.mean())] * FRAMES, rel=0.01)
            assert [one.exposure_us for one in taken] == EXPOSURES_US
        assert taken[-1].averaged.stale_frames >= delay - 1
