"""Moves of a Grbl axis against a controller that answers by script, in a time of its own."""

from collections.abc import Callable
from threading import Event

import pytest

from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceProtocolError,
    DeviceRefusalError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
    StageStalledError,
    StageStoppedError,
)
from acquisition.stages.grbl import OFFSET_REPORTS
from acquisition.stages.grbl_wire import JOG_CANCEL, Alarm, StatusReport
from acquisition.stages.motor import STOP_TIMEOUT_S, MotorStage, halt, travel
from tests.acquisition.scripted_grbl import (
    CONFIG,
    Answer,
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
