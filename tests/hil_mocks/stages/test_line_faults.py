"""Drivers on a bad line: a clear error or the right height, and never a blind move."""

from collections.abc import Callable
from itertools import product
from typing import Any

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
from hil_mocks.stages._serial_stage import LineFaults
from tests.hil_mocks.stage_checks import TARGET_MM, assert_works_again
from tests.hil_mocks.stage_rigs import (
    GrblRig,
    ZaberRig,
    grbl_rig,
    homed_grbl,
    homed_zaber,
    zaber_rig,
)

Rig = GrblRig | ZaberRig
Errors = type[DeviceError] | tuple[type[DeviceError], ...]
FRESH: dict[str, Callable[..., Rig]] = {"grbl": grbl_rig, "zaber": zaber_rig}
HOMED: dict[str, Callable[[], Rig]] = {"grbl": homed_grbl, "zaber": homed_zaber}

PASSING = {
    "byte by byte": LineFaults(chunk_bytes=1),
    "garbage before a line": LineFaults(before=b"\xf3\x80~", count=1),
    "garbage inside a line": LineFaults(inside=b"\xf3\x80~", count=1),
    "garbage after a line": LineFaults(after=b"\xf3\x80~", count=1),
    "a partial line": LineFaults(cut=True, count=1),
    "a merged line": LineFaults(merge=True, count=1),
}
PASSING_OF = {
    "grbl": {
        "three bytes at a time": LineFaults(chunk_bytes=3),
        "garbage lines between": LineFaults(after=b"\xf3\x80~\n", count=2),
        "NULs around lines": LineFaults(before=b"\0\0", after=b"\0\0"),
        "a NUL inside a line": LineFaults(inside=b"\0", count=1),
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
    },
    "zaber": {
        "a reply lost": LineFaults(lose=True, count=1),
        "every reply twice": LineFaults(duplicate=True),
        "a reply late": LineFaults(delay_s=3.0, count=1),
        "a corrupted digit": LineFaults(swap=b"07", count=1),
        "a corrupted letter": LineFaults(swap=b"IX", count=2),
    },
}
NOISE = (DeviceTimeoutError, DeviceProtocolError)
STOPPED: dict[str, tuple[LineFaults, Errors]] = {
    "mute": (LineFaults(mute=True), DeviceTimeoutError),
    "deaf": (LineFaults(deaf=True), DeviceTimeoutError),
    "another baud rate": (LineFaults(garbled=True), NOISE),
    "echo on": (LineFaults(echo=True), DeviceProtocolError),
    "a blocked port": (LineFaults(blocked=True), DeviceTimeoutError),
}
STOPPED_OF: dict[str, dict[str, tuple[LineFaults, Errors]]] = {
    "grbl": {
        "garbage in every line": (LineFaults(inside=b"\x80\xff"), DeviceProtocolError),
        "an over-long line": (LineFaults(after=b"x" * 4000, merge=True), DeviceProtocolError),
        "another device": (
            LineFaults(chatter=b"$GPGGA,1,2*6A\r\n", deaf=True),
            DeviceProtocolError,
        ),
    },
    "zaber": {
        "bad checksums": (LineFaults(swap=b"07"), DeviceProtocolError),
        "another device": (LineFaults(chatter=b"ok\r\n", deaf=True), DeviceProtocolError),
        "unplugged": (LineFaults(unplugged=True), DeviceDisconnectedError),
        "unplugged in mid-reply": (LineFaults(unplug_after_bytes=9), DeviceDisconnectedError),
    },
}


def by_controller(
    common: dict[str, Any], of: dict[str, dict[str, Any]], *moments_s: dict[str, tuple[float, ...]]
) -> list[Any]:
    """Every fault of each controller, at every moment of a move where some are given."""
    return [
        pytest.param(name, case, *at_s, id=" ".join(map(str, (name, kind, *at_s))))
        for name in HOMED
        for kind, case in (common | of[name]).items()
        for at_s in product(*(moments[name] for moments in moments_s))
    ]


@pytest.mark.parametrize(
    ("controller", "faults", "in_s"),
    # A reply of a Zaber at the start of a move is another one than in mid-move.
    by_controller(PASSING, PASSING_OF, {"grbl": (0.0, 2.0), "zaber": (0.0, 0.02, 2.0)}),
)
def test_a_move_gets_over_what_can_be_asked_again(
    controller: str, faults: LineFaults, in_s: float
) -> None:
    rig = HOMED[controller]()
    rig.in_mid_move(lambda: setattr(rig.line, "faults", faults), in_s)
    read_back_mm = rig.stage.move_to(TARGET_MM, 120)
    assert read_back_mm == pytest.approx(TARGET_MM, abs=rig.config.tolerance_mm)
    assert rig.plant.true_height_mm == pytest.approx(read_back_mm, abs=rig.round_mm)
    rig.line.faults = LineFaults()
    rig.wait(10.0)
    assert_works_again(rig)


@pytest.mark.parametrize(
    ("controller", "fault", "in_s"),
    by_controller(STOPPED, STOPPED_OF, {"grbl": (0.0, 2.0), "zaber": (0.0, 2.0)}),
)
def test_a_dead_line_is_an_error_and_the_stage_goes_nowhere_else(
    controller: str, fault: tuple[LineFaults, Errors], in_s: float
) -> None:
    faults, error = fault
    rig = HOMED[controller]()
    start_mm = rig.plant.true_height_mm
    if in_s == 0.0:
        rig.line.faults = faults
    else:
        rig.in_mid_move(lambda: setattr(rig.line, "faults", faults), in_s)
    with pytest.raises(error):
        rig.stage.move_to(TARGET_MM, 120)
    rig.wait(30.0)
    assert (rig.plant.true_height_mm > start_mm) == (in_s > 0)
    assert start_mm <= rig.plant.true_height_mm <= TARGET_MM + rig.round_mm
    rig.line.faults = LineFaults()
    rig.wait(5.0)
    if isinstance(rig, ZaberRig):
        # The device was powered all the time and knows where it is.
        assert rig.reopen().is_homed
    assert_works_again(rig)


@pytest.mark.parametrize(("controller", "fault"), by_controller(STOPPED, STOPPED_OF))
def test_a_dead_line_is_an_error_at_opening(
    controller: str, fault: tuple[LineFaults, Errors]
) -> None:
    rig = FRESH[controller](connect=False)
    rig.line.faults = fault[0]  # opening hears more of it than a single question does
    with pytest.raises((*NOISE, DeviceDisconnectedError)):
        rig.axis.connect()
    assert not rig.stage.is_homed
    rig.line.faults = LineFaults()
    rig.reopen().home(120)
    assert_works_again(rig)


def test_a_jog_that_was_lost_is_sent_again_only_after_the_position_was_read() -> None:
    rig = homed_grbl()
    rig.line.faults = LineFaults(deaf=True)
    rig.clock.at(0.3, lambda: setattr(rig.line, "faults", LineFaults()))
    # Deaf for the status query and the jog alike; the query is repeated, the jog comes after.
    assert rig.stage.move_to(TARGET_MM, 120) == pytest.approx(TARGET_MM, abs=0.01)
    jogs = [line for line in rig.firmware.lines_received if line.startswith("$J")]
    assert len(jogs) == 1


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
