"""The Grbl driver on a bad line: a clear error or the right height, and never a blind move."""

from collections.abc import Callable

import pytest

from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceError,
    DeviceProtocolError,
    DeviceResetError,
    DeviceTimeoutError,
    StageAlarmError,
    StageNotHomedError,
)
from hil_mocks.stages.serial_stage import LineFaults
from tests.hil_mocks.stage_checks import TARGET_MM, assert_works_again
from tests.hil_mocks.stage_rigs import GrblRig, grbl_rig, homed_grbl

PASSING = {
    "byte by byte": LineFaults(chunk_bytes=1),
    "three bytes at a time": LineFaults(chunk_bytes=3),
    "garbage before a line": LineFaults(before=b"\xf3\x80~", count=1),
    "garbage inside a line": LineFaults(inside=b"\xf3\x80~", count=1),
    "garbage after a line": LineFaults(after=b"\xf3\x80~", count=1),
    "garbage lines between": LineFaults(after=b"\xf3\x80~\n", count=2),
    "NULs around lines": LineFaults(before=b"\0\0", after=b"\0\0"),
    "a NUL inside a line": LineFaults(inside=b"\0", count=1),
    "a partial line": LineFaults(cut=True, count=1),
    "a merged line": LineFaults(merge=True, count=1),
    "an ok lost": LineFaults(only=b"ok", lose=True, count=1),
    "an ok twice": LineFaults(only=b"ok", duplicate=True, count=1),
    "every ok twice": LineFaults(only=b"ok", duplicate=True),
    "an ok late": LineFaults(only=b"ok", delay_s=3.0, count=1),
    "an ok very late": LineFaults(only=b"ok", delay_s=7.0, count=1),
    "an ok spoilt": LineFaults(only=b"ok", swap=b"kj", count=1),
    "a report lost": LineFaults(only=b"<", lose=True, count=2),
    "a report twice": LineFaults(only=b"<", duplicate=True, count=3),
    "a digit that is none": LineFaults(only=b"<", swap=b"0O", count=1),
    "a wrong digit": LineFaults(only=b"<", swap=b"05", count=1),
}


@pytest.mark.parametrize("faults", PASSING.values(), ids=PASSING)
@pytest.mark.parametrize("in_s", [0.0, 2.0], ids=["before the move", "in mid-move"])
def test_a_move_gets_over_what_can_be_asked_again(faults: LineFaults, in_s: float) -> None:
    rig = homed_grbl()
    rig.in_mid_move(lambda: setattr(rig.line, "faults", faults), in_s)
    read_back_mm = rig.stage.move_to(TARGET_MM, 120)
    assert read_back_mm == pytest.approx(TARGET_MM, abs=rig.config.tolerance_mm)
    assert rig.plant.true_height_mm == pytest.approx(read_back_mm, abs=rig.round_mm)
    rig.line.faults = LineFaults()
    rig.wait(10.0)
    assert_works_again(rig)


def test_a_jog_that_was_lost_is_sent_again_only_after_the_position_was_read() -> None:
    rig = homed_grbl()
    rig.line.faults = LineFaults(deaf=True)
    rig.clock.at(0.3, lambda: setattr(rig.line, "faults", LineFaults()))
    # Deaf for the status query and the jog alike; the query is repeated, the jog comes after.
    assert rig.stage.move_to(TARGET_MM, 120) == pytest.approx(TARGET_MM, abs=0.01)
    jogs = [line for line in rig.firmware.lines_received if line.startswith("$J")]
    assert len(jogs) == 1


NOISE = (DeviceTimeoutError, DeviceProtocolError)
STOPPED: dict[str, tuple[LineFaults, type[DeviceError] | tuple[type[DeviceError], ...]]] = {
    "mute": (LineFaults(mute=True), DeviceTimeoutError),
    "deaf": (LineFaults(deaf=True), DeviceTimeoutError),
    "garbage in every line": (LineFaults(inside=b"\x80\xff"), DeviceProtocolError),
    "another baud rate": (LineFaults(garbled=True), NOISE),
    "an over-long line": (
        LineFaults(after=b"x" * 4000, merge=True),
        DeviceProtocolError,
    ),
    "echo on": (LineFaults(echo=True), DeviceProtocolError),
    "another device": (
        LineFaults(chatter=b"$GPGGA,1,2*6A\r\n", deaf=True),
        DeviceProtocolError,
    ),
    "a blocked port": (LineFaults(blocked=True), DeviceTimeoutError),
}


@pytest.mark.parametrize(("faults", "error"), STOPPED.values(), ids=STOPPED)
def test_a_dead_line_is_an_error_before_anything_moves(
    faults: LineFaults, error: type[DeviceError] | tuple[type[DeviceError], ...]
) -> None:
    rig = homed_grbl()
    before_mm = rig.plant.true_height_mm
    rig.line.faults = faults
    with pytest.raises(error):
        rig.stage.move_to(TARGET_MM, 120)
    rig.wait(30.0)
    assert rig.plant.true_height_mm == before_mm
    rig.line.faults = LineFaults()
    rig.wait(5.0)
    assert_works_again(rig)


@pytest.mark.parametrize(("faults", "error"), STOPPED.values(), ids=STOPPED)
def test_a_line_that_dies_in_mid_move_is_an_error_and_the_stage_ends_on_its_way(
    faults: LineFaults, error: type[DeviceError] | tuple[type[DeviceError], ...]
) -> None:
    rig = homed_grbl()
    start_mm = rig.plant.true_height_mm
    rig.in_mid_move(lambda: setattr(rig.line, "faults", faults))
    with pytest.raises(error):
        rig.stage.move_to(TARGET_MM, 120)
    rig.wait(30.0)
    assert start_mm < rig.plant.true_height_mm <= TARGET_MM + rig.round_mm
    rig.line.faults = LineFaults()
    rig.wait(5.0)
    assert_works_again(rig)


@pytest.mark.parametrize(("faults", "error"), STOPPED.values(), ids=STOPPED)
def test_a_dead_line_is_an_error_at_opening(
    faults: LineFaults, error: type[DeviceError] | tuple[type[DeviceError], ...]
) -> None:
    del error  # opening hears more of the fault than a single question does
    rig = grbl_rig(connect=False)
    rig.line.faults = faults
    with pytest.raises(NOISE):
        rig.axis.connect()
    assert not rig.stage.is_homed
    rig.line.faults = LineFaults()
    rig.reopen().home(120)
    assert_works_again(rig)


def _unplug(rig: GrblRig) -> Callable[[], None]:
    return lambda: setattr(rig.line, "faults", LineFaults(unplugged=True))


def test_a_cable_pulled_when_idle_is_an_error_at_once_and_opening_anew_the_way_back() -> None:
    rig = homed_grbl()
    before_mm = rig.plant.true_height_mm
    rig.line.faults = LineFaults(unplugged=True)
    for call in (
        lambda: rig.stage.move_to(TARGET_MM, 120),
        rig.stage.position_mm,
        rig.stage.stop,
        lambda: rig.stage.home(120),
        rig.stage.clear_alarm,
    ):
        with pytest.raises(DeviceDisconnectedError):
            call()
    rig.wait(10.0)
    assert rig.plant.true_height_mm == before_mm
    rig.line.faults = LineFaults()
    rig.reopen()
    with pytest.raises(StageNotHomedError):
        rig.stage.move_to(TARGET_MM, 120)
    rig.stage.home(120)
    assert_works_again(rig)


def test_a_cable_pulled_in_mid_move_is_known_within_half_a_second_but_the_stage_runs_on() -> None:
    rig = homed_grbl()
    pulled_at = rig.clock.now_s + 2.0
    rig.in_mid_move(_unplug(rig), 2.0)
    with pytest.raises(DeviceDisconnectedError):
        rig.stage.move_to(TARGET_MM, 120)
    assert rig.clock.now_s - pulled_at < 0.5
    rig.wait(30.0)
    assert rig.plant.true_height_mm == pytest.approx(TARGET_MM, abs=rig.round_mm)
    rig.line.faults = LineFaults()
    rig.reopen().home(120)
    assert_works_again(rig)


def test_a_cable_pulled_in_mid_reply_is_an_error() -> None:
    rig = homed_grbl()
    rig.line.faults = LineFaults(unplug_after_bytes=7)
    with pytest.raises(DeviceDisconnectedError):
        rig.stage.position_mm()
    rig.line.faults = LineFaults()
    rig.reopen().home(120)
    assert_works_again(rig)


def test_the_homed_state_of_grblhal_survives_the_cable() -> None:
    rig = homed_grbl("grblhal")
    rig.in_mid_move(_unplug(rig), 2.0)
    with pytest.raises(DeviceDisconnectedError):
        rig.stage.move_to(TARGET_MM, 120)
    rig.wait(30.0)
    rig.line.faults = LineFaults()
    rig.reopen()
    assert rig.stage.is_homed
    assert rig.stage.position_mm() == pytest.approx(TARGET_MM, abs=0.01)


def test_opening_an_avr_board_resets_it_and_is_no_error() -> None:
    rig = homed_grbl()
    rig.firmware.power_cycle(boot_s=1.8)
    rig.reopen()
    assert rig.stage.state == "alarm"
    assert not rig.stage.is_homed
    rig.stage.home(120)
    assert_works_again(rig)


def test_a_stale_ok_at_opening_is_not_believed() -> None:
    rig = grbl_rig(connect=False)
    rig.line.faults = LineFaults(before=b"ok\r\nok\r\n", count=3)
    rig.axis.connect()
    rig.stage.home(120)
    assert_works_again(rig)


@pytest.mark.parametrize("fault", ["lose", "duplicate"])
@pytest.mark.parametrize("count", [1, 2])
def test_opening_and_homing_get_over_oks_that_are_lost_or_come_twice(
    fault: str, count: int
) -> None:
    rig = grbl_rig(connect=False)
    rig.line.faults = LineFaults(
        only=b"ok", count=count, lose=fault == "lose", duplicate=fault == "duplicate"
    )
    rig.axis.connect()
    rig.line.faults = LineFaults()
    rig.stage.home(120)
    assert_works_again(rig)


def test_a_port_that_takes_no_data_in_an_emergency_says_so() -> None:
    rig = homed_grbl()
    rig.line.faults = LineFaults(blocked=True)
    with pytest.raises(DeviceTimeoutError):
        rig.stage.emergency_stop()
    assert not rig.stage.is_homed


def test_a_lost_ok_of_homing_is_not_taken_for_homed() -> None:
    rig = grbl_rig()
    rig.in_mid_move(
        lambda: setattr(rig.line, "faults", LineFaults(only=b"ok", lose=True, count=1)), 3.0
    )
    with pytest.raises(DeviceTimeoutError):
        rig.stage.home(60)
    assert not rig.stage.is_homed
    rig.line.faults = LineFaults()
    rig.stage.home(120)
    assert_works_again(rig)


def test_a_reset_that_is_heard_late_still_voids_the_position() -> None:
    rig = homed_grbl()
    rig.firmware.press_reset()
    with pytest.raises(DeviceResetError):
        rig.stage.position_mm()
    assert not rig.stage.is_homed


def test_an_alarm_that_is_heard_while_getting_in_step_is_raised_and_no_jog_sent() -> None:
    rig = homed_grbl()
    rig.line.faults = LineFaults(only=b"ok", lose=True, count=1)

    def strike() -> None:
        rig.firmware.raise_alarm(3)

    # The ok of the jog is lost, so the driver gets in step before it sends anything more.
    rig.in_mid_move(strike, 0.1)
    jogs = len(rig.firmware.lines_received)
    with pytest.raises(StageAlarmError):
        rig.stage.move_to(TARGET_MM, 120)
    assert len(rig.firmware.lines_received) <= jogs + 1
    assert not rig.stage.is_homed
