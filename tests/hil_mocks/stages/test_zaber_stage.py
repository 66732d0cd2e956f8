"""The Zaber driver with a controller or mechanics at fault."""

import pytest

from acquisition.errors import (
    DeviceRefusalError,
    DeviceSettingsError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
)
from hil_mocks.stages._plant import PlantFaults
from hil_mocks.stages._zaber import ZaberFaults
from tests.hil_mocks.stage_checks import TARGET_MM, assert_works_again
from tests.hil_mocks.stage_rigs import homed_zaber, zaber_rig


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
    @pytest.mark.parametrize("flag", ["FS", "FE", "FQ", "FD", "FO", "FH", "FF"])
    def test_a_fault_is_an_alarm_with_its_flag(self, flag: str) -> None:
        rig = homed_zaber()
        faults = ZaberFaults(shows_flag=flag)
        rig.in_mid_move(lambda: setattr(rig.firmware, "faults", faults))
        with pytest.raises(StageAlarmError) as caught:
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
            with pytest.raises(DeviceRefusalError) as refused:
                call()
            assert refused.value.code == reason
        assert rig.plant.true_height_mm == before_mm
        rig.firmware.faults = ZaberFaults()
        rig.stage.home(120)
        assert_works_again(rig)

    def test_settings_are_compared(self) -> None:
        with pytest.raises(DeviceSettingsError) as refused:
            zaber_rig(expected_settings={"resolution": 128.0})
        assert refused.value.settings == ("resolution",)
        assert zaber_rig(expected_settings={"resolution": 64.0}).stage.state == "idle"

    def test_a_homed_device_says_so_to_the_next_process(self) -> None:
        rig = homed_zaber()
        rig.stage.move_to(TARGET_MM, 120)
        rig.reopen()
        assert rig.stage.is_homed
        assert rig.stage.position_mm() == pytest.approx(TARGET_MM, abs=0.01)


class TestMotion:
    def test_a_height_beyond_the_travel_of_the_device_is_refused_by_it(self) -> None:
        rig = homed_zaber(limits_mm=[10.0, 900.0])
        before_mm = rig.plant.true_height_mm
        with pytest.raises(StageLimitError) as refused:
            rig.stage.move_to(800.0, 120)
        assert refused.value.limits_mm is None  # the device says so
        assert rig.plant.true_height_mm == before_mm
        assert_works_again(rig)

    def test_a_stall_is_an_alarm_and_homing_the_way_back(self) -> None:
        rig = homed_zaber()
        rig.plant.faults = PlantFaults(stalls_above_mm=58.0)
        with pytest.raises(StageAlarmError) as stalled:
            rig.stage.move_to(TARGET_MM, 120)
        assert stalled.value.code == "FS"
        assert rig.plant.true_height_mm == pytest.approx(58.0, abs=0.01)
        rig.plant.faults = PlantFaults()
        with pytest.raises(StageAlarmError):
            rig.stage.move_to(20.0, 120)
        rig.stage.clear_alarm()
        with pytest.raises(StageNotHomedError):
            rig.stage.move_to(20.0, 120)
        rig.stage.home(120)
        assert_works_again(rig)

    def test_a_stage_that_counts_downwards_is_turned_round(self) -> None:
        rig = homed_zaber(direction="down", home_offset_mm=500.0, limits_mm=[150.0, 500.0])
        before_mm = rig.plant.true_height_mm
        rig.stage.move_to(490.0, 60)
        assert rig.plant.true_height_mm == pytest.approx(before_mm + 10.0, abs=0.01)
