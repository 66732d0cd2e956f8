"""A GRBL axis: moves, its reference, and firmware."""

from collections.abc import Callable
from threading import Event
from typing import Any

import pytest
from hypothesis import given, strategies as st

from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceError,
    DeviceProtocolError,
    DeviceRefusalError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
    StageStalledError,
    StageStoppedError,
)
from acquisition.stages._grbl import OFFSET_REPORTS, reference_error_mm
from acquisition.stages._grbl_setup import GrblSetup
from acquisition.stages._motor import STOP_TIMEOUT_S, MotorStage, halt, travel
from acquisition.stages.grbl_controller import (
    _Heard,
    _no_version_error,
    _read_firmware,
    _too_old_error,
    waiting_error,
)
from acquisition.stages.grbl_wire import (
    JOG_CANCEL,
    Alarm,
    ErrorReply,
    Feedback,
    StatusReport,
    parse_line,
)
from tests.acquisition.scripted_grbl import (
    CONFIG,
    Answer,
    CreepingController,
    ScriptedController,
    Time,
    at,
    axis_of,
)

DEADLINE_S = 60.0


def go(controller: ScriptedController, height_mm: float = 70.0, *, stop: bool = False) -> None:
    """Travel to a height; 70 mm is 50 mm on the machine."""
    asked = Event()
    if stop:
        asked.set()
    travel(
        axis_of(controller),
        height_mm,
        tolerance_mm=CONFIG.tolerance_mm,
        deadline=DEADLINE_S,
        stop=asked,
    )


def settle(controller: ScriptedController, timeout_s: float = 60.0) -> float:
    """Height read back after a move to 70 mm."""
    time = Time()
    stage = MotorStage(CONFIG, axis_of(controller, time), clock=time.clock, sleep=time.sleep)
    return stage.move_to(70.0, timeout_s)


def test_a_lost_ok_is_made_good_where_the_stage_arrived_all_the_same() -> None:
    controller = ScriptedController(
        [at(30.0, "Jog"), at(50.0), at(50.0)], [DeviceTimeoutError("no answer")]
    )
    go(controller)
    assert len(controller.sent) == 1


def test_a_lost_jog_is_sent_once_more_and_no_third_time() -> None:
    lost = DeviceTimeoutError("no answer")
    controller = ScriptedController([at(10.0)], [DeviceProtocolError("garbled"), lost])
    with pytest.raises(DeviceTimeoutError) as raised:
        go(controller)
    assert raised.value is lost
    assert len(controller.sent) == 2


def test_a_stage_that_stands_elsewhere_is_told_in_heights() -> None:
    with pytest.raises(StageStoppedError) as stopped:
        go(ScriptedController([at(30.0, "Jog"), at(40.0)]))
    assert stopped.value.height_mm == 60.0
    assert not stopped.value.is_asked


def test_a_stop_before_the_move_sends_nothing() -> None:
    controller = ScriptedController([at(10.0)])
    with pytest.raises(StageStoppedError) as stopped:
        go(controller, stop=True)
    assert stopped.value.is_asked
    assert controller.sent == []


def test_a_stop_that_comes_with_the_jog_cancels_it() -> None:
    stop = Event()

    class Stopped(ScriptedController):
        def command(self, line: str) -> Answer:
            stop.set()
            return super().command(line)

    controller = Stopped([at(12.0)])
    with pytest.raises(StageStoppedError) as stopped:
        travel(axis_of(controller), 70.0, tolerance_mm=0.01, deadline=DEADLINE_S, stop=stop)
    assert stopped.value.height_mm == 32.0
    assert controller.sent[1:] == [JOG_CANCEL]


ARRIVED = [at(40.0), at(50.0), at(50.0)]
"""Ready below its target, then two reports that it stands there."""


def test_a_height_is_read_back_when_two_readings_agree() -> None:
    reports = [at(50.002, "Jog"), at(50.004), at(50.005), at(50.005)]
    assert settle(ScriptedController([*ARRIVED, *reports])) == 70.005


def test_a_stage_that_creeps_or_crept_away_has_not_settled() -> None:
    creeping = [at(50.0 + 0.001 * k) for k in range(5000)]
    with pytest.raises(DeviceTimeoutError) as late:
        settle(ScriptedController([*ARRIVED, *creeping]), timeout_s=1.0)
    assert late.value.timeout_s == 1.0
    # It is not waited for until the time limit: 2 s of steady creep are enough.
    with pytest.raises(StageStalledError) as stalled:
        settle(ScriptedController([*ARRIVED, *creeping]), timeout_s=500.0)
    assert stalled.value.timeout_s == 2.0
    assert 70.0 < stalled.value.height_mm < 70.05
    # It came to rest beyond the tolerance of 0.01 mm.
    with pytest.raises(DeviceTimeoutError):
        settle(ScriptedController([*ARRIVED, at(50.0), at(50.02), at(50.02)]))


def stop(controller: ScriptedController) -> None:
    time = Time()
    halt(axis_of(controller, time), clock=time.clock, sleep=time.sleep)


def test_a_cancelled_jog_is_waited_for() -> None:
    controller = ScriptedController([at(30.0, "Jog"), at(31.0, "Jog"), at(31.5)])
    stop(controller)
    assert controller.sent == [JOG_CANCEL]
    assert controller.is_position_known


@pytest.mark.parametrize("reset_error", [None, DeviceTimeoutError("no banner")])
def test_a_stage_that_does_not_stop_is_reset_and_its_position_void(
    reset_error: Exception | None,
) -> None:
    controller = ScriptedController([at(30.0, "Jog")])
    controller.reset_error = reset_error
    with pytest.raises(DeviceTimeoutError) as raised:
        stop(controller)
    assert raised.value.timeout_s == STOP_TIMEOUT_S
    assert controller.sent == [JOG_CANCEL, "reset"]
    assert not controller.is_position_known


def test_a_line_that_is_gone_at_the_reset_is_the_error_that_matters() -> None:
    controller = ScriptedController([at(30.0, "Jog")])
    controller.reset_error = DeviceDisconnectedError("unplugged")
    with pytest.raises(DeviceDisconnectedError):
        stop(controller)


def test_a_work_position_counts_with_its_offset_as_soon_as_one_was_sent() -> None:
    work = StatusReport(state="Idle", work=(0.0, 0.0, 7.0))
    controller = ScriptedController([work])
    controller.offset = (0.0, 0.0, 30.0)
    assert axis_of(controller).reported_mm(work) == 57.0


@pytest.mark.parametrize(
    "report",
    [
        pytest.param(StatusReport(state="Idle"), id="no position at all"),
        pytest.param(StatusReport(state="Idle", machine=(1.0, 2.0)), id="a machine without Z"),
        pytest.param(StatusReport(state="Idle", work=(0.0, 0.0, 7.0)), id="no offset"),
    ],
)
def test_a_controller_without_machine_position_is_told_with_the_setting(
    report: StatusReport,
) -> None:
    asked: list[int] = []
    controller = ScriptedController([report])
    status: Callable[[], StatusReport] = controller.status

    def counted() -> StatusReport:
        asked.append(1)
        return status()

    controller.status = counted  # type: ignore[method-assign]  # counts the reports
    with pytest.raises(DeviceProtocolError):
        axis_of(controller).reported_mm(report)
    # Grbl sends the offset at least with every 30th.
    assert len(asked) == OFFSET_REPORTS


@pytest.mark.parametrize(
    ("report", "alarm", "code"),
    [
        (StatusReport(state="Door"), None, "Door"),
        (StatusReport(state="Alarm", substate=2), Alarm(1), 2),
        (StatusReport(state="Alarm"), Alarm(1), 1),
        (StatusReport(state="Alarm"), None, None),
    ],
)
def test_a_controller_that_takes_no_move_voids_the_position_and_says_why(
    report: StatusReport, alarm: Alarm | None, code: int | str | None
) -> None:
    controller = ScriptedController([report])
    controller.alarm = alarm
    error = axis_of(controller).not_ready(report)
    assert isinstance(error, StageAlarmError)
    assert error.code == code
    assert not controller.is_position_known


def test_a_moving_stage_keeps_its_position() -> None:
    controller = ScriptedController([at(30.0, "Run")])
    assert not isinstance(axis_of(controller).not_ready(at(30.0, "Run")), StageAlarmError)
    assert controller.is_position_known


@pytest.mark.parametrize("code", [5, 9, 250])
def test_a_refused_jog_keeps_its_code(code: int) -> None:
    with pytest.raises(DeviceRefusalError) as refused:
        go(ScriptedController([at(10.0)], [Answer(code)]))
    assert refused.value.code == code


def test_a_jog_beyond_the_travel_of_the_firmware_is_a_limit() -> None:
    with pytest.raises(StageLimitError) as refused:
        go(ScriptedController([at(10.0)], [Answer(15)]))
    assert (refused.value.height_mm, refused.value.limits_mm) == (70.0, None)


SETUP = GrblSetup(
    is_homing_enabled=True,
    keeps_homed_on_reset=False,
    towards_switch=1.0,
    pull_off_mm=1.5,
    locate_feed_mm_per_min=25.0,
)
HOME_MM = 18.5
"""After homing the stage stands the pull-off below its switch, which is at 20 mm: machine 0."""


def error_of(controller: CreepingController, deadline: float = 1000.0) -> float | None:
    return reference_error_mm(
        axis_of(controller), SETUP, home_mm=HOME_MM, deadline=deadline, stop=Event()
    )


@pytest.mark.parametrize("lost_mm", [0.0, 0.1, 0.4])
def test_lost_steps_are_what_the_switch_is_off_by(lost_mm: float) -> None:
    # The stage stands higher by what it lost going down: its switch answers earlier.
    controller = CreepingController(-30.0, lambda z_mm: z_mm >= -lost_mm - 1e-9)
    assert error_of(controller) == pytest.approx(lost_mm, abs=0.02)
    assert not controller.pressed(controller.z_mm)


def test_a_switch_beyond_where_it_should_be_is_not_found() -> None:
    assert error_of(CreepingController(-30.0, lambda z_mm: z_mm >= 0.2)) is None


def test_a_switch_that_is_reached_on_the_way_home_already_is_found_as_well() -> None:
    controller = CreepingController(-30.0, lambda z_mm: z_mm >= -4.0)
    assert error_of(controller) == pytest.approx(4.0, abs=0.02)
    # Once at the feed of a move, once at that of homing.
    seeks = [line for line in controller.sent if isinstance(line, str) and "F25" in line]
    assert len(seeks) == 1


def test_a_firmware_that_keeps_off_its_switch_tells_nothing() -> None:
    controller = CreepingController(-30.0, lambda _: False)
    controller.refuse_with = Answer(15)
    assert error_of(controller) is None


class Alarmed(CreepingController):
    """Raises an alarm when its switch answers, as with hard limits on."""

    def __init__(self, code: int) -> None:
        super().__init__(-30.0, lambda z_mm: z_mm >= -0.3)
        self._code = code
        self.was_reset = False

    def status(self) -> Any:
        report = super().status()
        if report.pins and not self.was_reset:
            raise StageAlarmError(f"ALARM:{self._code}", code=self._code)
        return report

    def reset(self) -> None:
        super().reset()
        self.was_reset = True


def test_a_hard_limit_is_what_is_looked_for() -> None:
    controller = Alarmed(1)
    assert error_of(controller) == pytest.approx(0.3, abs=0.02)
    assert controller.was_reset


def test_another_alarm_is_an_alarm() -> None:
    with pytest.raises(StageAlarmError) as alarmed:
        error_of(Alarmed(2))
    assert alarmed.value.code == 2


def test_a_check_that_takes_too_long_stops_the_stage() -> None:
    controller = CreepingController(-300.0, lambda _: False)
    with pytest.raises(DeviceTimeoutError):
        error_of(controller, deadline=2.0)
    stands_mm = controller.z_mm
    controller.status()
    assert controller.z_mm == stands_mm


def test_a_switch_that_stays_pressed_is_named() -> None:
    controller = CreepingController(-2.0, lambda _: True)
    with pytest.raises(StageAlarmError) as stuck:
        error_of(controller)
    assert stuck.value.code == "switch"


# The answer of grblHAL 1.1f.20260817 in its own simulator, with the lines that a board adds.
GRBLHAL = (
    b"[VER:1.1f.20260817:stand 7]",
    b"[OPT:VNMZHL+,100,1024,3,0]",
    b"[AXS:3:XYZ]",
    b"[NEWOPT:ENUMS,RT+,HOME,TC,SED]",
    b"[FIRMWARE:grblHAL]",
    b"[SIGNALS:D]",
    b"[NVS STORAGE:*EEPROM]",
    b"[FREE MEMORY:131K]",
    b"[DRIVER:RP2350@150MHz]",
    b"[DRIVER VERSION:260324]",
    b"[BOARD:PicoCNC]",
    b"[AUX IO:2,3,0,0]",
    b"[WIFI MAC:02:00:00:00:00:01]",
    b"[PLUGIN:Networking v0.2]",
    b"[PLUGIN:FS stream v0.9]",
)


def feedback(*lines: bytes) -> tuple[Feedback, ...]:
    parsed = [parse_line(line) for line in lines]
    return tuple(message for message in parsed if isinstance(message, Feedback))


def test_the_answer_of_grblhal_is_read() -> None:
    firmware = _read_firmware(feedback(*GRBLHAL))
    assert (firmware.family, firmware.version) == ("grblHAL", "1.1f.20260817")
    assert (firmware.user_text, firmware.board) == ("stand 7", "PicoCNC")
    assert firmware.sets_origin


def test_the_answer_of_grbl_is_read() -> None:
    firmware = _read_firmware(feedback(b"[VER:1.1h.20190830:]", b"[OPT:V,15,128]"))
    assert (firmware.family, firmware.version, firmware.board) == ("Grbl", "1.1h.20190830", "")
    assert not firmware.sets_origin


@pytest.mark.slow
@given(
    st.lists(
        st.tuples(st.from_regex(r"[A-Z]{3}[A-Z ]{3,9}X", fullmatch=True), st.text(max_size=20))
    )
)
def test_lines_that_newer_firmware_adds_change_nothing(added: list[tuple[str, str]]) -> None:
    extra = tuple(Feedback(kind, text) for kind, text in added)
    assert _read_firmware((*feedback(*GRBLHAL), *extra)) == _read_firmware(feedback(*GRBLHAL))


def test_an_old_grbl_is_told_with_its_version_the_one_that_is_needed_and_the_remedy() -> None:
    text = str(_too_old_error("the Grbl stage on /dev/ttyUSB0", "0.9j"))
    assert "Grbl 0.9j; Grbl 1.1 is needed" in text
    assert "flash Grbl 1.1 or grblHAL" in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("refusal", "heard", "alarm", "kind"),
    [
        (ErrorReply(8), _Heard(garbage=b"x"), Alarm(1), DeviceTimeoutError),
        (ErrorReply(3), _Heard(), None, DeviceProtocolError),
        (None, _Heard(garbage=b"$GPGGA"), Alarm(1), DeviceProtocolError),
        (None, _Heard(), Alarm(1), StageAlarmError),
        (None, _Heard(), None, DeviceTimeoutError),
    ],
)
def test_a_controller_without_a_version_is_told_by_what_it_said_instead(
    refusal: ErrorReply | None, heard: _Heard, alarm: Alarm | None, kind: type[DeviceError]
) -> None:
    assert type(_no_version_error("it", refusal, heard, alarm)) is kind


@pytest.mark.parametrize("state", ["Hold", "Door", "Tool", "Check", "Sleep", "Cooling"])
def test_a_state_that_waits_is_the_code_of_its_error(state: str) -> None:
    error = waiting_error("it", state)
    assert error.code == state
    assert f"state {state}" in str(error)
