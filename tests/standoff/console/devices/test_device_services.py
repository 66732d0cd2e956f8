"""The threads that own camera and stage, over scripted and simulated devices."""

import time
from collections.abc import Iterator
from pathlib import Path
from threading import Event, Lock, Thread, current_thread

import pytest

from acquisition.devices import Camera, Stage
from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceError,
    OperatorStopError,
    StreamInterruptedError,
)
from hil_mocks import SimulatedBench
from hil_mocks.devices import CameraFaults, RealTimeClock, StageFaults
from standoff.console.devices.camera_service import CameraService
from standoff.console.devices.frame_broadcaster import FrameBroadcaster
from standoff.console.devices.stage_service import StageService
from tests.standoff.console.hub_fixtures import small_bench, wait_for


class CameraMaker:
    """Opens a new simulated camera each time; the cable can be out."""

    def __init__(self) -> None:
        self.is_unplugged = False
        self.opened: list[SimulatedBench] = []

    def __call__(self) -> Camera:
        if self.is_unplugged:
            raise DeviceDisconnectedError("no camera answers")
        bench = SimulatedBench(small_bench(), clock=RealTimeClock())
        self.opened.append(bench)
        return bench.camera


@pytest.fixture
def maker() -> CameraMaker:
    return CameraMaker()


@pytest.fixture
def broadcaster() -> FrameBroadcaster:
    return FrameBroadcaster()


@pytest.fixture
def camera(maker: CameraMaker, broadcaster: FrameBroadcaster) -> Iterator[CameraService]:
    service = CameraService(maker, broadcaster)
    service.start()
    yield service
    service.close()


def frames(broadcaster: FrameBroadcaster) -> int:
    return broadcaster.counts.complete


def test_a_camera_streams_until_it_is_closed(
    camera: CameraService, broadcaster: FrameBroadcaster
) -> None:
    wait_for(lambda: frames(broadcaster) > 3, "frames")
    assert camera.status.is_ready
    assert camera.info is not None
    camera.close()
    before = frames(broadcaster)
    with pytest.raises(DeviceDisconnectedError), camera.lent():
        pass
    assert frames(broadcaster) == before


def test_exposure_and_gain_are_set_between_frames(
    camera: CameraService, broadcaster: FrameBroadcaster
) -> None:
    wait_for(lambda: frames(broadcaster) > 0, "frames")
    camera.set_exposure_us(5000.0)
    camera.set_gain_db(3.0)
    wait_for(
        lambda: (
            camera.settings is not None
            and (camera.settings.exposure_us, camera.settings.gain_db) == (5000.0, 3.0)
        ),
        "settings",
    )


def test_a_setting_that_is_refused_is_told_and_the_stream_goes_on(
    maker: CameraMaker, broadcaster: FrameBroadcaster
) -> None:
    told: list[str] = []
    service = CameraService(maker, broadcaster, report=told.append)
    service.start()
    try:
        service.set_gain_db(90.0)
        wait_for(lambda: bool(told), "told")
        assert "0 to 31 dB" in told[0]
        before = frames(broadcaster)
        wait_for(lambda: frames(broadcaster) > before, "frames")
    finally:
        service.close()


def test_a_lent_camera_is_the_borrowers_and_everybody_sees_its_frames(
    camera: CameraService, broadcaster: FrameBroadcaster
) -> None:
    wait_for(lambda: frames(broadcaster) > 0, "frames")
    with camera.lent() as lent:
        lent.start()
        before = frames(broadcaster)
        taken = [lent.next_frame(1.0).frame_id for _ in range(5)]
        assert frames(broadcaster) == before + 5
        assert taken == [1, 2, 3, 4, 5]
        lent.stop()
        wait_for(lambda: frames(broadcaster) > before + 6, "the live stream between two captures")
    wait_for(lambda: frames(broadcaster) > before + 12, "the live stream afterwards")


class TurnOfALatecomer:
    """The lock of a camera's turns, to which threads named ``late`` come when the time is right."""

    def __init__(self) -> None:
        self._lock = Lock()
        self.is_asked, self.is_time = Event(), Event()

    def acquire(self, timeout: float = -1) -> bool:
        if current_thread().name == "late":
            self.is_asked.set()
            self.is_time.wait()
        return self._lock.acquire(timeout=timeout)

    def release(self) -> None:
        self._lock.release()

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


def test_the_stream_waits_for_the_last_of_several_who_want_the_camera(
    monkeypatch: pytest.MonkeyPatch, camera: CameraService
) -> None:
    wait_for(lambda: camera.status.is_ready, "a camera")
    turn = TurnOfALatecomer()
    camera.take_turn()
    monkeypatch.setattr(camera, "_turn", turn)
    turn.acquire()
    late = Thread(target=camera.take_turn, name="late", daemon=True)
    late.start()
    assert turn.is_asked.wait(30.0)
    camera.give_turn()
    time.sleep(0.2)  # in which the stream would begin
    turn.is_time.set()
    late.join(30.0)
    assert not late.is_alive()
    camera.give_turn()


@pytest.mark.slow
def test_a_stop_ends_what_the_borrower_does(
    camera: CameraService, broadcaster: FrameBroadcaster
) -> None:
    wait_for(lambda: frames(broadcaster) > 0, "frames")
    stop = Event()

    def check() -> None:
        if stop.is_set():
            raise OperatorStopError("stopped")

    with camera.lent(check) as lent:
        lent.start()
        lent.next_frame(1.0)
        stop.set()
        with pytest.raises(OperatorStopError):
            lent.next_frame(1.0)
    before = frames(broadcaster)
    wait_for(lambda: frames(broadcaster) > before, "the live stream")


@pytest.mark.slow
def test_who_borrows_a_camera_that_was_lost_a_moment_ago_gets_it_when_it_is_back(
    camera: CameraService, maker: CameraMaker
) -> None:
    wait_for(lambda: camera.status.is_ready, "ready")
    maker.is_unplugged = True
    maker.opened[-1].camera.faults = CameraFaults(disconnect_at=0)
    wait_for(lambda: camera.status.state == "lost", "lost")
    assert camera.is_expected
    asked = Event()

    def plug_in() -> None:
        asked.wait(10)
        maker.is_unplugged = False

    Thread(target=plug_in, daemon=True).start()
    with camera.lent(asked.set) as lent:
        lent.start()
        assert lent.next_frame(1.0).is_complete
        lent.stop()


@pytest.mark.slow
def test_a_lost_camera_is_shown_and_opened_again_with_its_exposure(
    camera: CameraService, broadcaster: FrameBroadcaster, maker: CameraMaker
) -> None:
    wait_for(lambda: frames(broadcaster) > 0, "frames")
    camera.set_exposure_us(4000.0)
    wait_for(lambda: getattr(camera.settings, "exposure_us", 0) == 4000.0, "exposure")
    maker.is_unplugged = True
    maker.opened[-1].camera.faults = CameraFaults(disconnect_at=0)
    wait_for(lambda: camera.status.state == "lost", "lost")
    assert "cable" in camera.status.remedy
    with pytest.raises(DeviceDisconnectedError), camera.lent():
        pass
    maker.is_unplugged = False
    wait_for(lambda: camera.status.is_ready, "ready")
    before = frames(broadcaster)
    wait_for(lambda: frames(broadcaster) > before, "frames")
    assert getattr(camera.settings, "exposure_us", 0) == 4000.0
    assert len(maker.opened) == 2


def test_a_stream_that_broke_off_in_a_run_is_the_runs_to_begin_again(
    broadcaster: FrameBroadcaster,
) -> None:
    bench = SimulatedBench(small_bench(), clock=RealTimeClock())
    breaks = Event()

    class Breaking:
        """Breaks off once, as a real camera does."""

        def __getattr__(self, name: str) -> object:
            return getattr(bench.camera, name)

        def next_frame(self, timeout_s: float) -> object:
            if breaks.is_set():
                breaks.clear()
                bench.camera.stop()
                raise StreamInterruptedError("no frame for 1 s")
            return bench.camera.next_frame(timeout_s)

    camera: Camera = Breaking()  # type: ignore[assignment]  # hands everything else on
    service = CameraService(lambda: camera, broadcaster)
    service.start()
    try:
        wait_for(lambda: frames(broadcaster) > 0, "frames")
        with service.lent() as lent:
            lent.start()
            lent.next_frame(1.0)
            breaks.set()
            with pytest.raises(StreamInterruptedError):
                lent.next_frame(1.0)
            assert service.status.state == "lost"
            lent.stop()
            lent.start()
            assert service.status.is_ready
            assert lent.next_frame(1.0).is_complete
            lent.stop()
        before = frames(broadcaster)
        wait_for(lambda: frames(broadcaster) > before, "the live stream")
    finally:
        service.close()


class StageMaker:
    """Opens the same simulated stage again and again; the cable can be out."""

    def __init__(self, **keys: object) -> None:
        self.stage = SimulatedBench(small_bench(**keys), clock=RealTimeClock()).stage
        self.opened: list[bool] = []

    def __call__(self, is_again: bool) -> Stage:
        if self.stage.faults.unplugged:
            raise DeviceDisconnectedError("the port is not there")
        self.opened.append(is_again)
        self.stage._is_open = True
        return self.stage


@pytest.fixture
def slow_stage() -> Iterator[tuple[StageMaker, StageService]]:
    maker = StageMaker(stage__feed_mm_per_min=6000.0)
    service = StageService(maker, limits_mm=(120.0, 620.0))
    service.start()
    wait_for(lambda: service.status.is_ready, "the stage")
    yield maker, service
    service.close()


@pytest.mark.slow
def test_a_stage_is_homed_and_moved_and_shown_meanwhile(
    slow_stage: tuple[StageMaker, StageService],
) -> None:
    _, service = slow_stage
    assert service.view.height_mm is None
    stage = service.lent()
    stage.home(60.0)
    seen: set[str] = set()
    heights: set[float | None] = set()
    mover = Thread(target=stage.move_to, args=(320.0, 60.0))
    mover.start()
    while mover.is_alive():
        seen.add(service.view.state)
        heights.add(service.view.height_mm)
        mover.join(0.02)
    assert "moving" in seen
    assert len(heights) > 2
    wait_for(lambda: service.view.height_mm == 320.0, "read back")
    assert (service.view.state, service.view.is_homed) == ("idle", True)


@pytest.mark.slow
def test_a_stop_from_another_thread_ends_a_move_as_a_stop(
    slow_stage: tuple[StageMaker, StageService],
) -> None:
    _, service = slow_stage
    stop = Event()

    def check() -> None:
        if stop.is_set():
            raise OperatorStopError("stopped by the operator")

    stage = service.lent(check)
    stage.home(60.0)
    ended: list[BaseException] = []

    def move() -> None:
        try:
            stage.move_to(600.0, 60.0)
        except DeviceError as error:
            ended.append(error)

    mover = Thread(target=move)
    mover.start()
    wait_for(lambda: (service.view.height_mm or 0.0) > 150.0, "under way")
    stop.set()
    service.stop()
    mover.join(300)
    assert isinstance(ended[0], OperatorStopError)
    height_mm = service.view.height_mm
    assert height_mm is not None
    assert 150.0 < height_mm < 600.0
    assert service.view.is_homed


@pytest.mark.slow
def test_a_stage_without_its_cable_is_shown_and_opened_again_with_a_stop_first(
    slow_stage: tuple[StageMaker, StageService],
) -> None:
    maker, service = slow_stage
    maker.stage.faults = StageFaults(unplugged=True)
    wait_for(lambda: service.status.state == "lost", "lost")
    assert "continues to its target" in service.status.remedy
    with pytest.raises(DeviceDisconnectedError):
        service.lent()
    with pytest.raises(DeviceDisconnectedError):
        service.stop()
    maker.stage.faults = StageFaults()
    wait_for(lambda: service.status.is_ready, "ready again")
    assert maker.opened == [False, True]


def test_a_stage_that_was_never_there_says_what_to_do(tmp_path: Path) -> None:
    def absent(_: bool) -> Stage:
        raise DeviceDisconnectedError("no such port")

    service = StageService(absent, limits_mm=(0.0, 1.0))
    service.start()
    try:
        wait_for(lambda: service.status.state == "lost", "lost")
        assert "port in the bench file" in service.status.remedy
    finally:
        service.close()
