"""What the threads that own camera and stage do when a device fails in their hands."""

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from threading import Event

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
)
from standoff.console.devices.camera_service import CameraService
from standoff.console.devices.frame_broadcaster import FrameBroadcaster
from standoff.console.devices.stage_service import StageService
from tests.acquisition.fakes import SETTINGS, ScriptedCamera, ScriptedStage, steady_frames
from tests.standoff.console.hub_fixtures import wait_for


@pytest.fixture(autouse=True)
def quick_retries(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a lost device tried again at once."""
    monkeypatch.setattr("standoff.console.devices.camera_service.RETRY_S", 0.01)
    monkeypatch.setattr("standoff.console.devices.stage_service.RETRY_S", 0.01)


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
