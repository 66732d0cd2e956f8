"""The threads that own camera and stage, over scripted and simulated devices, and their faults."""

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Event, Lock, Thread, current_thread

import pytest

from acquisition.devices import Camera, Frame, Stage, StageState
from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceError,
    DeviceInUseError,
    DeviceProtocolError,
    DriverMissingError,
    OperatorStopError,
    StageAlarmError,
    StageNotHomedError,
    StreamInterruptedError,
)
from hil_mocks import SimulatedBench, StageFaults
from hil_mocks.devices import CameraFaults, RealTimeClock
from standoff.console.camera_service import CameraService
from standoff.console.frames import FrameBroadcaster
from standoff.console.stage_service import StageService
from tests.acquisition.fakes import SETTINGS, ScriptedCamera, ScriptedStage, steady_frames
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
    camera._take_turn()
    monkeypatch.setattr(camera, "_turn", turn)
    turn.acquire()
    late = Thread(target=camera._take_turn, name="late", daemon=True)
    late.start()
    assert turn.is_asked.wait(30.0)
    camera._give_turn()
    time.sleep(0.2)  # in which the stream would begin
    turn.is_time.set()
    late.join(30.0)
    assert not late.is_alive()
    camera._give_turn()


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


@pytest.fixture(autouse=True)
def quick_retries(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a lost device tried again at once."""
    monkeypatch.setattr("standoff.console.camera_service.RETRY_S", 0.01)
    monkeypatch.setattr("standoff.console.stage_service.RETRY_S", 0.01)


@contextmanager
def camera_service(open_camera: Callable[[], Camera], **options: object) -> Iterator[CameraService]:
    broadcaster = FrameBroadcaster()
    service = CameraService(open_camera, broadcaster, **options)  # type: ignore[arg-type]  # its own
    service.start()
    try:
        yield service
    finally:
        service.close()


class FailingCamera(ScriptedCamera):
    """A scripted camera that may refuse to start, and counts how often it was given back."""

    def __init__(self, *frames: Frame | BaseException) -> None:
        super().__init__(frames or steady_frames())
        self.start_error: Exception | None = None
        self.starts = self.closed = 0

    def start(self) -> None:
        if self.start_error is not None:
            raise self.start_error
        self.starts += 1
        super().start()

    def close(self) -> None:
        super().close()
        self.closed += 1


def test_without_its_driver_the_console_says_to_install_it() -> None:
    def missing() -> Camera:
        raise DriverMissingError("Aravis is not installed: apt install gir1.2-aravis-0.8")

    with camera_service(missing) as service:
        wait_for(lambda: service.status.state == "lost", "lost")
        assert service.status.text.startswith("Aravis is not installed")
        assert service.status.remedy == "Install it, then start the console again."


def test_a_camera_that_sends_nothing_is_given_back_and_opened_anew() -> None:
    opened: list[FailingCamera] = []

    def another() -> Camera:
        # The first one sends three frames, then nothing; its clock passes with every time limit.
        camera = FailingCamera(*([*steady(3)] if not opened else ()))
        opened.append(camera)
        return camera

    clock = lambda: opened[0].clock.now_s if opened else 0.0  # noqa: E731 - a clock, not a step
    with camera_service(another, clock=clock) as service:
        wait_for(lambda: len(opened) == 2 and service.status.is_ready, "opened anew")
        assert opened[0].closed == 1
        assert not opened[0].is_streaming


def steady(count: int) -> list[Frame]:
    frames = steady_frames()
    return [next(frames) for _ in range(count)]


def test_a_stream_whose_end_fails_too_is_lost_for_the_first_reason() -> None:
    camera = FailingCamera(*steady(1), DeviceDisconnectedError("the cable is out"))
    camera.stop_error = DeviceError("no answer to stop")
    gone = iter([camera])

    def once() -> Camera:
        found = next(gone, None)
        if found is None:
            raise DeviceDisconnectedError("no camera answers")
        return found

    with camera_service(once) as service:
        wait_for(lambda: camera.closed == 1, "given back")
        assert service.status.state == "lost"
        wait_for(lambda: service.status.text == "no camera answers", "tried again")
        assert "cable" in service.status.remedy


def test_a_cable_pulled_while_a_setting_is_made_is_a_lost_camera() -> None:
    told: list[str] = []
    opened: list[FailingCamera] = []

    class Deaf(FailingCamera):
        def set_gain_db(self, gain_db: float) -> float:
            if len(opened) == 1:
                raise DeviceDisconnectedError("the cable is out")
            return super().set_gain_db(gain_db)

    def another() -> Camera:
        opened.append(Deaf())
        return opened[-1]

    with camera_service(another, report=told.append) as service:
        wait_for(lambda: service.status.is_ready, "ready")
        service.set_gain_db(3.0)
        wait_for(lambda: len(opened) == 2 and service.status.is_ready, "opened anew")
        assert opened[0].closed == 1
        assert told == []  # no refusal: it did not answer


def test_a_borrower_sets_gain_and_exposure_and_keeps_its_turn_while_it_streams() -> None:
    camera = FailingCamera()
    with camera_service(lambda: camera) as service:
        wait_for(lambda: service.status.is_ready, "ready")
        with service.lent() as lent:
            assert lent.set_gain_db(6.0) == 6.0
            assert lent.info.model == "Scripted"
            lent.start()
            assert lent.set_exposure_us(4000.0) == 4000.0
            starts = camera.starts
            ids = [lent.next_frame(1.0).frame_id for _ in range(3)]
            assert ids == list(range(ids[0], ids[0] + 3))  # nobody else took a frame
            assert camera.starts == starts
            assert lent.settings == replace(SETTINGS, gain_db=6.0, exposure_us=4000.0)
            lent.stop()
            assert lent.statistics().complete_frames >= 3
            lent.close()
            lent.close()
        wait_for(lambda: camera.is_streaming, "the live stream")


@pytest.mark.parametrize(
    "error", [DeviceDisconnectedError("the cable is out"), DeviceError("it streams already")]
)
def test_a_start_that_fails_in_a_run_gives_the_camera_back(error: DeviceError) -> None:
    camera = FailingCamera()
    with camera_service(lambda: camera) as service:
        wait_for(lambda: service.status.is_ready, "ready")
        with service.lent() as lent:
            camera.start_error = error
            with pytest.raises(DeviceError) as raised:
                lent.start()
            assert raised.value is error
            wait_for(lambda: service.status.state == "lost", "lost")
            assert service.status.text == str(error)
            camera.start_error = None
            wait_for(lambda: service.status.is_ready and camera.is_streaming, "the live stream")


class FailingStage(ScriptedStage):
    """A scripted stage that raises where told: at a reading, a height, a homing."""

    def __init__(self, *, is_homed: bool = True) -> None:
        super().__init__(is_homed=is_homed)
        self.read_error: DeviceError | None = None
        self.height_error: DeviceError | None = None
        self.home_error: DeviceError | None = None
        self.closed = 0

    @property
    def state(self) -> StageState:
        if self.read_error is not None:
            raise self.read_error
        return "idle"

    @state.setter
    def state(self, _: StageState) -> None:
        """The script's is not looked at."""

    def position_mm(self) -> float:
        if self.height_error is not None:
            raise self.height_error
        return super().position_mm()

    def home(self, timeout_s: float) -> None:
        if self.home_error is not None:
            raise self.home_error
        super().home(timeout_s)

    def close(self) -> None:
        self.closed += 1


@contextmanager
def stage_service(open_stage: Callable[[bool], Stage]) -> Iterator[StageService]:
    service = StageService(open_stage, limits_mm=(0.0, 300.0))
    service.start()
    try:
        yield service
    finally:
        service.close()


def test_a_port_that_another_program_has_is_named_until_it_is_free() -> None:
    taken = [DeviceInUseError("another program has /dev/ttyUSB0 open")]

    def opened(_: bool) -> Stage:
        if taken:
            raise taken[0]
        return FailingStage()

    with stage_service(opened) as service:
        wait_for(lambda: service.status.state == "lost", "lost")
        assert service.status.text == "another program has /dev/ttyUSB0 open"
        assert "no other program has it open" in service.status.remedy
        taken.clear()
        wait_for(lambda: service.status.is_ready, "ready")


def test_an_answer_that_is_not_understood_closes_no_port() -> None:
    stage = FailingStage()
    with stage_service(lambda _: stage) as service:
        wait_for(lambda: service.view.height_mm is not None, "a height")
        stage.read_error = DeviceProtocolError("not understood: <Idl")
        wait_for(lambda: service.status.state == "lost", "lost")
        assert service.view.height_mm is None
        with pytest.raises(DeviceDisconnectedError):
            service.lent()
        stage.read_error = None
        wait_for(lambda: service.status.is_ready, "ready")
        assert stage.closed == 0


def test_a_height_that_was_lost_between_two_questions_is_not_shown() -> None:
    stage = FailingStage()
    with stage_service(lambda _: stage) as service:
        wait_for(lambda: service.view.height_mm is not None, "a height")
        stage.height_error = StageNotHomedError("an alarm came meanwhile")
        wait_for(lambda: service.view.height_mm is None, "no height")
        assert service.status.is_ready


def test_a_cable_pulled_while_a_job_homes_is_a_lost_stage() -> None:
    opened: list[bool] = []
    stage = FailingStage(is_homed=False)

    def again(is_again: bool) -> Stage:
        opened.append(is_again)
        if is_again:
            raise DeviceDisconnectedError("the port is gone")
        return stage

    with stage_service(again) as service:
        wait_for(lambda: service.status.is_ready, "ready")
        lent = service.lent()
        stage.home_error = DeviceDisconnectedError("the stage does not answer")
        with pytest.raises(DeviceDisconnectedError) as raised:
            lent.home(60.0)
        assert raised.value is stage.home_error
        assert stage.closed == 1
        assert service.status.state == "lost"
        assert "emergency stop" in service.status.remedy
        with pytest.raises(DeviceDisconnectedError):
            lent.home(60.0)  # what was lent before stays lost
        assert service.view.height_mm is None
        wait_for(lambda: len(opened) > 1, "tried again")
        assert opened[1]  # it may still move: it is to be stopped first


@pytest.mark.parametrize("is_stopped", [False, True])
def test_a_homing_that_fails_fails_as_itself_unless_the_operator_stopped_it(
    is_stopped: bool,
) -> None:
    stage = FailingStage(is_homed=False)
    stop = Event()

    def check() -> None:
        if stop.is_set():
            raise OperatorStopError("stopped by the operator")

    with stage_service(lambda _: stage) as service:
        wait_for(lambda: service.status.is_ready, "ready")
        lent = service.lent(check)

        def home(timeout_s: float) -> None:
            if is_stopped:
                stop.set()
            raise StageAlarmError("the switch was not found")

        stage.home = home  # type: ignore[method-assign]  # fails in mid-homing
        with pytest.raises(DeviceError) as failed:
            lent.home(60.0)
        assert isinstance(failed.value, OperatorStopError) is is_stopped
        said = [str(failed.value), *getattr(failed.value, "__notes__", [])]
        assert "the switch was not found" in said
        assert service.status.is_ready
        stop.set()
        with pytest.raises(OperatorStopError):
            lent.move_to(100.0, 60.0)
        assert stage.moves_mm == []  # nothing moved


def test_a_camera_that_falls_silent_between_two_captures_of_a_job_stays_the_jobs() -> None:
    is_silent = Event()
    camera = FailingCamera()
    camera.script = itertools.takewhile(lambda _: not is_silent.wait(0.001), steady_frames())
    opened: list[FailingCamera] = []

    def the_same() -> Camera:
        opened.append(camera)
        return camera

    with camera_service(the_same, clock=lambda: camera.clock.now_s) as service:
        wait_for(lambda: bool(opened) and service.status.is_ready, "ready")
        with service.lent() as lent:
            is_silent.set()
            wait_for(lambda: camera.starts >= 3, "begun again in vain")
            assert (camera.closed, len(opened)) == (0, 1)
            assert lent.settings == SETTINGS
        wait_for(lambda: camera.closed > 0, "given back once nobody needs it")
