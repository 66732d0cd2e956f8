"""Moves of a Grbl axis against a controller that answers by script, in a time of its own."""

from collections.abc import Callable

import pytest

from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceError,
    DeviceProtocolError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
)
from acquisition.stages.grbl.motion import OFFSET_REPORTS
from acquisition.stages.grbl.wire import JOG_CANCEL, Alarm, StatusReport
from tests.acquisition.scripted_grbl import Answer, ScriptedController, at, motion_of


def test_a_lost_ok_is_made_good_where_the_stage_arrived_all_the_same() -> None:
    controller = ScriptedController(
        [at(30.0, "Jog"), at(50.0), at(50.0)], [DeviceTimeoutError("no answer")]
    )
    motion_of(controller).travel(50.0, 60.0)
    assert len(controller.sent) == 1


def test_a_lost_jog_is_sent_once_more_and_no_third_time() -> None:
    stays = [at(10.0)]
    lost = [DeviceProtocolError("garbled"), DeviceTimeoutError("no answer")]
    controller = ScriptedController(stays, lost)
    with pytest.raises(DeviceTimeoutError, match="no answer"):
        motion_of(controller).travel(50.0, 60.0)
    assert len(controller.sent) == 2


def test_a_stage_that_stands_elsewhere_is_told_in_heights() -> None:
    controller = ScriptedController([at(30.0, "Jog"), at(40.0)])
    with pytest.raises(DeviceError, match=r"stopped at 60\.000 mm, not at 70\.000 mm; home it and"):
        motion_of(controller).travel(50.0, 60.0)


def test_a_stop_before_the_move_sends_nothing() -> None:
    controller = ScriptedController([at(10.0)])
    motion = motion_of(controller)
    motion.is_stop_wanted = True
    with pytest.raises(DeviceError, match="was told to stop; nothing more was sent"):
        motion.travel(50.0, 60.0)
    assert controller.sent == []


def test_a_stop_that_comes_with_the_jog_cancels_it() -> None:
    controller = ScriptedController([at(12.0)])
    motion = motion_of(controller)
    motion.is_stop_wanted = True
    assert motion.jog(50.0, 300.0) is None
    assert controller.sent[1:] == [JOG_CANCEL]


def test_a_height_is_read_back_when_two_readings_agree() -> None:
    controller = ScriptedController([at(50.002, "Jog"), at(50.004), at(50.005), at(50.005)])
    assert motion_of(controller).settle(70.0, 60.0) == 70.005


def test_a_stage_that_creeps_is_told_with_where_it_is() -> None:
    creeping = [at(50.0 + 0.001 * k) for k in range(5000)]
    with pytest.raises(DeviceTimeoutError, match=r"it creeps, now at 70\.0\d\d mm"):
        motion_of(ScriptedController(creeping)).settle(70.0, 5.0)
    # It came to rest beyond the tolerance of 0.01 mm.
    with pytest.raises(DeviceTimeoutError, match=r"it crept to 70\.020 mm"):
        motion_of(ScriptedController([at(50.0), at(50.02), at(50.02)])).settle(70.0, 60.0)


def test_a_cancelled_jog_is_waited_for() -> None:
    controller = ScriptedController([at(30.0, "Jog"), at(31.0, "Jog"), at(31.5)])
    motion_of(controller).cancel()
    assert controller.sent == [JOG_CANCEL]
    assert controller.is_position_known


@pytest.mark.parametrize("reset_error", [None, DeviceTimeoutError("no banner")])
def test_a_stage_that_does_not_stop_is_reset_and_its_position_void(
    reset_error: Exception | None,
) -> None:
    controller = ScriptedController([at(30.0, "Jog")])
    controller.reset_error = reset_error
    with pytest.raises(DeviceTimeoutError, match="did not stop within 5 s and was reset: home it"):
        motion_of(controller).cancel()
    assert controller.sent == [JOG_CANCEL, "reset"]
    assert not controller.is_position_known


def test_a_line_that_is_gone_at_the_reset_is_the_error_that_matters() -> None:
    controller = ScriptedController([at(30.0, "Jog")])
    controller.reset_error = DeviceDisconnectedError("unplugged")
    with pytest.raises(DeviceDisconnectedError, match="unplugged"):
        motion_of(controller).cancel()


def test_a_work_position_counts_with_its_offset_as_soon_as_one_was_sent() -> None:
    work = StatusReport(state="Idle", work=(0.0, 0.0, 7.0))
    controller = ScriptedController([work])
    controller.offset = (0.0, 0.0, 30.0)
    assert motion_of(controller).machine_mm(work) == 37.0
    assert motion_of(controller).height_mm(work) == 57.0


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
    with pytest.raises(DeviceProtocolError, match=r"no machine position of Z; set \$10=1"):
        motion_of(controller).machine_mm(report)
    # Grbl sends the offset at least with every 30th.
    assert len(asked) == OFFSET_REPORTS


@pytest.mark.parametrize(
    ("report", "alarm", "text", "code"),
    [
        (StatusReport(state="Door"), None, r"state Door, .*close its door", "Door"),
        (StatusReport(state="Alarm", substate=2), Alarm(1), "is in alarm 2; clear", 2),
        (StatusReport(state="Alarm"), Alarm(1), "is in alarm 1; clear the alarm", 1),
        (StatusReport(state="Alarm"), None, "is in alarm; clear the alarm, then home", None),
    ],
)
def test_a_controller_that_takes_no_move_voids_the_position_and_says_why(
    report: StatusReport, alarm: Alarm | None, text: str, code: int | str | None
) -> None:
    controller = ScriptedController([report])
    controller.alarm = alarm
    with pytest.raises(StageAlarmError, match=text) as refused:
        raise motion_of(controller).not_ready(report)
    assert refused.value.code == code
    assert not controller.is_position_known


def test_a_moving_stage_keeps_its_position() -> None:
    controller = ScriptedController([at(30.0, "Run")])
    assert "is moving; stop it or wait" in str(motion_of(controller).not_ready(at(30.0, "Run")))
    assert controller.is_position_known


@pytest.mark.parametrize(
    ("code", "kind", "text"),
    [
        (15, StageLimitError, r"limits_mm or home_offset_mm in the bench file do not fit"),
        (5, DeviceError, r"cannot home: error:5 .*set \$22=1"),
        (9, DeviceError, r"refuses with error:9 .*; nothing moved"),
        (250, DeviceError, r"error:250 \(see the manual\)"),
    ],
)
def test_a_refused_jog_says_what_the_code_means(
    code: int, kind: type[DeviceError], text: str
) -> None:
    controller = ScriptedController([at(10.0)], [Answer(code)])
    with pytest.raises(kind, match=text):
        motion_of(controller).travel(50.0, 60.0)
