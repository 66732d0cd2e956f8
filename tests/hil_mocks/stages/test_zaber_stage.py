"""The Zaber driver on a bad line, with a controller or mechanics at fault."""

import contextlib

import pytest

from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceError,
    DeviceProtocolError,
    DeviceResetError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
)
from hil_mocks.stages.plant import PlantFaults
from hil_mocks.stages.serial_line import LineFaults
from hil_mocks.stages.zaber import ZaberFaults
from tests.hil_mocks.stage_rigs import MICROSTEP_UM, ZaberRig, homed_zaber, zaber_rig

TARGET_MM = 120.0
ROUND_MM = 0.006  # a step of homing at 1 mm/s and a microstep


def assert_works_again(rig: ZaberRig) -> None:
    read_back_mm = rig.stage.move_to(60.0, 120)
    assert read_back_mm == pytest.approx(60.0, abs=rig.config.tolerance_mm)
    assert rig.plant.true_height_mm == pytest.approx(read_back_mm, abs=ROUND_MM)


PASSING = {
    "byte by byte": LineFaults(chunk_bytes=1),
    "garbage before a line": LineFaults(before=b"\xf3\x80~", count=1),
    "garbage inside a line": LineFaults(inside=b"\xf3\x80~", count=1),
    "garbage after a line": LineFaults(after=b"\xf3\x80~", count=1),
    "a partial line": LineFaults(cut=True, count=1),
    "a merged line": LineFaults(merge=True, count=1),
    "a reply lost": LineFaults(lose=True, count=1),
    "every reply twice": LineFaults(duplicate=True),
    "a reply late": LineFaults(delay_s=3.0, count=1),
    "a corrupted digit": LineFaults(swap=b"07", count=1),
    "a corrupted letter": LineFaults(swap=b"IX", count=2),
}


@pytest.mark.parametrize("faults", PASSING.values(), ids=PASSING)
@pytest.mark.parametrize("in_s", [0.0, 0.02, 2.0], ids=["before", "at the start", "in mid-move"])
def test_a_move_gets_over_what_can_be_asked_again(faults: LineFaults, in_s: float) -> None:
    rig = homed_zaber()
    rig.in_mid_move(lambda: setattr(rig.line, "faults", faults), in_s)
    read_back_mm = rig.stage.move_to(TARGET_MM, 120)
    assert read_back_mm == pytest.approx(TARGET_MM, abs=rig.config.tolerance_mm)
    assert rig.plant.true_height_mm == pytest.approx(read_back_mm, abs=ROUND_MM)
    rig.line.faults = LineFaults()
    rig.wait(5.0)
    assert_works_again(rig)


STOPPED: dict[str, tuple[LineFaults, type[DeviceError], str]] = {
    "mute": (LineFaults(mute=True), DeviceTimeoutError, "did not answer"),
    "deaf": (LineFaults(deaf=True), DeviceTimeoutError, "did not answer"),
    "bad checksums": (LineFaults(swap=b"07"), DeviceProtocolError, "wrong checksum"),
    "another baud rate": (LineFaults(garbled=True), DeviceError, r"answer|without an end"),
    "echo on": (LineFaults(echo=True), DeviceProtocolError, "not a Zaber message"),
    "another device": (
        LineFaults(chatter=b"ok\r\n", deaf=True),
        DeviceProtocolError,
        "not a Zaber message",
    ),
    "a blocked port": (LineFaults(blocked=True), DeviceTimeoutError, "takes no data"),
    "unplugged": (LineFaults(unplugged=True), DeviceDisconnectedError, "gone"),
    "unplugged in mid-reply": (
        LineFaults(unplug_after_bytes=9),
        DeviceDisconnectedError,
        "gone",
    ),
}


@pytest.mark.parametrize(("faults", "error", "match"), STOPPED.values(), ids=STOPPED)
@pytest.mark.parametrize("in_s", [0.0, 2.0], ids=["before", "in mid-move"])
def test_a_dead_line_is_an_error_and_the_stage_goes_nowhere_else(
    faults: LineFaults, error: type[DeviceError], match: str, in_s: float
) -> None:
    rig = homed_zaber()
    start_mm = rig.plant.true_height_mm
    rig.in_mid_move(lambda: setattr(rig.line, "faults", faults), in_s)
    with pytest.raises(error, match=match):
        rig.stage.move_to(TARGET_MM, 120)
    rig.wait(30.0)
    if in_s == 0.0 and "unplugged" not in match:
        assert rig.plant.true_height_mm == start_mm
    assert start_mm <= rig.plant.true_height_mm <= TARGET_MM + ROUND_MM
    rig.line.faults = LineFaults()
    rig.wait(2.0)
    rig.reopen()
    # The device was powered all the time and knows where it is.
    assert rig.stage.is_homed
    assert_works_again(rig)


def test_an_echoing_line_at_opening_is_an_error() -> None:
    rig = zaber_rig(connect=False)
    rig.line.faults = LineFaults(garbled=True)
    with pytest.raises(DeviceError, match="baud"):
        rig.stage.connect()


def test_alerts_and_info_lines_between_replies_are_passed_over() -> None:
    rig = zaber_rig()
    rig.firmware.faults = ZaberFaults(alerts=True)
    rig.stage.home(120)
    assert_works_again(rig)


def test_it_says_who_it_is() -> None:
    info = zaber_rig().stage.info
    assert (info.vendor, info.model, info.firmware) == ("Zaber", "device 50081", "7.38")
    assert info.serial_number == "12345"


def test_the_feed_of_the_bench_file_is_its_speed() -> None:
    rig = homed_zaber(feed_mm_per_min=600.0)
    start_s = rig.clock.now_s
    rig.stage.move_to(110.0, 120)
    # 100 mm at 10 mm/s, two ramps of 0.05 s, 0.5 s to settle, and the questions asked
    assert rig.clock.now_s - start_s == pytest.approx(10.6, abs=0.3)


class TestController:
    @pytest.mark.parametrize("in_s", [0.0, 2.0], ids=["idle", "mid-move"])
    def test_a_reset_voids_the_position(self, in_s: float) -> None:
        rig = homed_zaber()
        rig.in_mid_move(rig.firmware.power_cycle, in_s)
        with pytest.raises(DeviceResetError, match="was reset"):
            rig.stage.move_to(TARGET_MM, 120)
        stopped_mm = rig.plant.true_height_mm
        with pytest.raises(StageNotHomedError):
            rig.stage.move_to(TARGET_MM, 120)
        rig.wait(10.0)
        assert rig.plant.true_height_mm == stopped_mm < TARGET_MM
        rig.stage.home(120)
        assert_works_again(rig)

    @pytest.mark.parametrize("in_s", [0.0, 2.0], ids=["idle", "mid-move"])
    def test_a_controller_that_hangs_is_a_timeout(self, in_s: float) -> None:
        rig = homed_zaber()
        hangs = ZaberFaults(hangs=True)
        rig.in_mid_move(lambda: setattr(rig.firmware, "faults", hangs), in_s)
        with pytest.raises(DeviceTimeoutError):
            rig.stage.move_to(TARGET_MM, 120)
        rig.firmware.faults = ZaberFaults()
        rig.firmware.power_cycle()
        with pytest.raises(DeviceError):
            rig.stage.move_to(TARGET_MM, 120)
        rig.reopen().home(120)
        assert_works_again(rig)

    @pytest.mark.parametrize("flag", ["FS", "FE", "FQ", "FD", "FO", "FH", "FF"])
    def test_a_fault_is_an_alarm_with_its_flag(self, flag: str) -> None:
        rig = homed_zaber()
        faults = ZaberFaults(shows_flag=flag)
        rig.in_mid_move(lambda: setattr(rig.firmware, "faults", faults))
        with pytest.raises(StageAlarmError, match=flag) as caught:
            rig.stage.move_to(TARGET_MM, 120)
        assert caught.value.code == flag
        assert rig.stage.state == "alarm"
        assert not rig.stage.is_homed
        rig.wait(20.0)
        before_mm = rig.plant.true_height_mm
        with pytest.raises(StageAlarmError):
            rig.stage.move_to(50.0, 120)
        assert rig.plant.true_height_mm == before_mm
        rig.stage.clear_alarm()
        rig.firmware.faults = ZaberFaults()
        with pytest.raises(StageNotHomedError):
            rig.stage.move_to(50.0, 120)
        rig.stage.home(120)
        assert_works_again(rig)

    @pytest.mark.parametrize("reason", ["STATUSBUSY", "PARKED", "DRIVERDISABLED", "NEWREASON"])
    def test_a_rejection_names_its_reason(self, reason: str) -> None:
        rig = homed_zaber()
        before_mm = rig.plant.true_height_mm
        rig.firmware.faults = ZaberFaults(rejects=reason)
        for call in (lambda: rig.stage.move_to(TARGET_MM, 60), lambda: rig.stage.home(60)):
            with pytest.raises(DeviceError, match=reason):
                call()
        assert rig.plant.true_height_mm == before_mm
        rig.firmware.faults = ZaberFaults()
        rig.stage.home(120)
        assert_works_again(rig)

    def test_settings_are_compared(self) -> None:
        with pytest.raises(DeviceError, match="resolution is 64, expected 128"):
            zaber_rig(expected_settings={"resolution": 128.0})
        assert zaber_rig(expected_settings={"resolution": 64.0}).stage.state == "idle"

    def test_an_emergency_stop_in_mid_move_halts_at_once(self) -> None:
        rig = homed_zaber()
        rig.in_mid_move(rig.stage.emergency_stop)
        with pytest.raises(DeviceError):
            rig.stage.move_to(TARGET_MM, 120)
        stopped_mm = rig.plant.true_height_mm
        assert stopped_mm < TARGET_MM
        with pytest.raises(StageAlarmError, match="emergency"):
            rig.stage.home(120)
        with pytest.raises(StageNotHomedError):
            rig.stage.position_mm()
        rig.wait(5.0)
        assert rig.plant.true_height_mm == stopped_mm
        rig.stage.clear_alarm()
        rig.stage.home(120)
        assert_works_again(rig)

    def test_a_homed_device_says_so_to_the_next_process(self) -> None:
        rig = homed_zaber()
        rig.stage.move_to(TARGET_MM, 120)
        rig.reopen()
        assert rig.stage.is_homed
        assert rig.stage.position_mm() == pytest.approx(TARGET_MM, abs=0.01)

    def test_an_unhomed_device_says_so_too(self) -> None:
        rig = zaber_rig()
        assert not rig.stage.is_homed
        with pytest.raises(StageNotHomedError):
            rig.stage.move_to(TARGET_MM, 120)
        with pytest.raises(StageNotHomedError):
            rig.stage.position_mm()


class TestMotion:
    @pytest.mark.parametrize("height_mm", [float("nan"), float("inf"), -1.0, 400.01])
    def test_a_height_that_is_none_is_refused_before_anything_is_sent(
        self, height_mm: float
    ) -> None:
        rig = homed_zaber()
        sent = len(rig.firmware.commands_received)
        with pytest.raises(StageLimitError, match="nothing moved"):
            rig.stage.move_to(height_mm, 120)
        assert len(rig.firmware.commands_received) == sent

    def test_a_height_beyond_the_travel_of_the_device_is_refused_by_it(self) -> None:
        rig = homed_zaber(limits_mm=[10.0, 900.0])
        before_mm = rig.plant.true_height_mm
        with pytest.raises(StageLimitError, match="out of range"):
            rig.stage.move_to(800.0, 120)
        assert rig.plant.true_height_mm == before_mm
        assert_works_again(rig)

    def test_a_home_switch_that_is_not_found_is_an_alarm(self) -> None:
        rig = zaber_rig()
        rig.plant.faults = PlantFaults(home_switch_dead=True)
        with pytest.raises(StageAlarmError):
            rig.stage.home(120)
        assert not rig.stage.is_homed
        rig.plant.faults = PlantFaults()
        rig.plant.place(30.0)
        rig.stage.clear_alarm()
        rig.stage.home(120)
        assert_works_again(rig)

    def test_homing_that_takes_too_long_is_stopped(self) -> None:
        rig = zaber_rig()
        with pytest.raises(DeviceTimeoutError, match="is not homed within 3 s"):
            rig.stage.home(3.0)
        stopped_mm = rig.plant.true_height_mm
        rig.wait(10.0)
        assert rig.plant.true_height_mm == stopped_mm
        rig.stage.home(120)
        assert_works_again(rig)

    def test_a_stall_is_an_alarm_and_homing_the_way_back(self) -> None:
        rig = homed_zaber()
        rig.plant.faults = PlantFaults(stalls_above_mm=58.0)
        with pytest.raises(StageAlarmError, match="stalled"):
            rig.stage.move_to(TARGET_MM, 120)
        assert rig.plant.true_height_mm == pytest.approx(58.0, abs=0.01)
        rig.plant.faults = PlantFaults()
        with pytest.raises(StageAlarmError):
            rig.stage.move_to(20.0, 120)
        rig.stage.clear_alarm()
        with pytest.raises(StageNotHomedError):
            rig.stage.move_to(20.0, 120)
        rig.stage.home(120)
        assert_works_again(rig)

    def test_a_stop_in_mid_move_keeps_the_position(self) -> None:
        rig = homed_zaber()
        rig.in_mid_move(rig.stage.stop, 3.0)
        with pytest.raises(DeviceError, match="as it was told to"):
            rig.stage.move_to(TARGET_MM, 120)
        assert rig.stage.is_homed
        assert 10.5 < rig.stage.position_mm() < TARGET_MM
        assert_works_again(rig)

    def test_a_keyboard_interrupt_while_homing_leaves_a_stage_that_can_be_stopped(self) -> None:
        rig = zaber_rig()

        def interrupt() -> None:
            raise KeyboardInterrupt

        rig.in_mid_move(interrupt, 2.0)
        with pytest.raises(KeyboardInterrupt):
            rig.stage.home(120)
        rig.stage.stop()
        stopped_mm = rig.plant.true_height_mm
        rig.wait(10.0)
        assert rig.plant.true_height_mm == stopped_mm
        assert not rig.stage.is_homed
        rig.stage.home(120)
        assert_works_again(rig)

    def test_a_move_that_takes_too_long_is_stopped_with_its_position_kept(self) -> None:
        rig = homed_zaber()
        with pytest.raises(DeviceTimeoutError, match="it was stopped at"):
            rig.stage.move_to(TARGET_MM, 2.0)
        stopped_mm = rig.plant.true_height_mm
        rig.wait(10.0)
        assert rig.plant.true_height_mm == stopped_mm < TARGET_MM
        assert rig.stage.is_homed
        assert_works_again(rig)

    def test_a_move_that_ends_short_is_an_error(self) -> None:
        rig = homed_zaber()
        rig.firmware.faults = ZaberFaults(stops_short_mm=0.4)
        with pytest.raises(DeviceError, match=r"stopped at 119\.600 mm"):
            rig.stage.move_to(TARGET_MM, 120)
        rig.firmware.faults = ZaberFaults()
        assert_works_again(rig)

    def test_a_stage_that_never_stands_gets_an_emergency_stop(self) -> None:
        rig = homed_zaber()
        rig.in_mid_move(lambda: setattr(rig.firmware, "faults", ZaberFaults(never_idle=True)))
        with pytest.raises(DeviceTimeoutError, match="did not stop"):
            rig.stage.move_to(TARGET_MM, 30)
        assert not rig.stage.is_homed
        assert "estop" in rig.firmware.commands_received
        rig.firmware.faults = ZaberFaults()
        rig.stage.home(120)
        assert_works_again(rig)

    def test_a_stage_that_creeps_is_not_settled(self) -> None:
        rig = homed_zaber()
        rig.in_mid_move(lambda: setattr(rig.plant, "faults", PlantFaults(creep_mm_per_s=0.1)), 5.0)
        with pytest.raises(DeviceError, match=r"crept|creeps"):
            rig.stage.move_to(TARGET_MM, 15)
        rig.plant.faults = PlantFaults()
        assert_works_again(rig)

    def test_a_stage_that_counts_downwards_is_turned_round(self) -> None:
        rig = homed_zaber(direction="down", home_offset_mm=500.0, limits_mm=[150.0, 500.0])
        before_mm = rig.plant.true_height_mm
        rig.stage.move_to(490.0, 60)
        assert rig.plant.true_height_mm == pytest.approx(before_mm + 10.0, abs=0.01)

    def test_backlash_does_not_show(self) -> None:
        rig = zaber_rig()
        rig.plant.faults = PlantFaults(backlash_mm=0.3)
        rig.stage.home(120)
        offsets_mm = []
        for height_mm in (200.0, 100.0, 99.9, 250.0, 40.0):
            read_back_mm = rig.stage.move_to(height_mm, 120)
            offsets_mm.append(rig.plant.true_height_mm - read_back_mm)
        assert max(offsets_mm) - min(offsets_mm) < MICROSTEP_UM / 1000

    @pytest.mark.parametrize("in_s", [0.1 * k for k in range(32)])
    def test_after_a_stop_the_stage_only_ramps_down_whenever_it_comes(self, in_s: float) -> None:
        rig = homed_zaber()
        rig.stage.move_to(60.0, 120)
        rig.plant.faults = PlantFaults()
        at_stop_mm: list[float] = []

        def stop() -> None:
            at_stop_mm.append(rig.plant.true_height_mm)
            rig.stage.stop()

        # Downwards to 20.5 mm past the target, then up to it: two moves, 2.9 s in all.
        rig.in_mid_move(stop, in_s)
        with contextlib.suppress(DeviceError):
            rig.stage.move_to(21.0, 120)
        rig.wait(20.0)
        # 1 mm of ramp at 20 mm/s, and what it moves until the stop is heard
        assert abs(rig.plant.true_height_mm - at_stop_mm[0]) < 1.3
        assert rig.stage.is_homed
