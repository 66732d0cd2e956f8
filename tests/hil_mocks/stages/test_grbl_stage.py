"""The Grbl driver with a controller or mechanics at fault, and what makes it sure it is homed."""

import pytest

from acquisition.errors import (
    DeviceError,
    DeviceRefusalError,
    DeviceResetError,
    DeviceSettingsError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
)
from hil_mocks.stages._grbl import GrblFaults
from hil_mocks.stages._grbl_protocol import GrblDialect
from hil_mocks.stages._plant import PlantFaults
from tests.hil_mocks.stage_checks import (
    DIALECTS,
    TARGET_MM,
    assert_nothing_moves,
    assert_works_again,
    clear_home_and_work,
)
from tests.hil_mocks.stage_rigs import grbl_rig, homed_grbl


class TestController:
    @DIALECTS
    def test_a_reset_when_idle_voids_the_position_whatever_the_state_says(
        self, dialect: GrblDialect
    ) -> None:
        rig = homed_grbl(dialect)
        rig.firmware.press_reset()
        assert rig.stage.state == "idle"
        assert not rig.stage.is_homed
        assert "was reset" in rig.stage.warnings[0]
        assert_nothing_moves(rig)
        rig.stage.home(120)
        assert_works_again(rig)

    @DIALECTS
    def test_a_reset_in_mid_move_ends_it(self, dialect: GrblDialect) -> None:
        rig = homed_grbl(dialect)
        rig.in_mid_move(rig.firmware.press_reset)
        with pytest.raises((StageAlarmError, DeviceResetError)):
            rig.stage.move_to(TARGET_MM, 120)
        assert rig.plant.true_height_mm < TARGET_MM
        assert not rig.stage.is_homed
        assert_nothing_moves(rig) if rig.stage.state == "alarm" else None
        clear_home_and_work(rig)

    @DIALECTS
    def test_it_starts_in_alarm_where_homing_is_required(self, dialect: GrblDialect) -> None:
        rig = grbl_rig(dialect)
        assert rig.stage.state == "alarm"
        with pytest.raises(StageNotHomedError):
            rig.stage.move_to(TARGET_MM, 120)
        rig.stage.home(120)
        assert_works_again(rig)

    def test_an_unlocked_stage_is_still_not_homed(self) -> None:
        rig = grbl_rig()
        rig.stage.clear_alarm()
        assert rig.stage.state == "idle"
        assert_nothing_moves(rig)

    def test_grblhal_that_unlocks_only_by_homing_is_homed_from_its_alarm(self) -> None:
        rig = grbl_rig("grblhal", settings={22: 5})
        rig.stage.clear_alarm()
        assert rig.stage.state == "alarm"
        rig.stage.home(120)
        assert_works_again(rig)

    def test_settings_that_were_lost_are_named(self) -> None:
        expected = {"$102": 250.0, "$132": 400.0}
        rig = homed_grbl(expected_settings=expected)
        rig.firmware.lose_settings()
        before_mm = rig.plant.true_height_mm
        for call in (lambda: rig.stage.home(120), rig.reopen):
            with pytest.raises(DeviceSettingsError) as lost:
                call()
            assert lost.value.settings == ("$102",)
        assert rig.plant.true_height_mm == before_mm
        rig.firmware.settings.update({102: 250, 22: 1, 23: 4, 20: 1})
        rig.reopen().home(120)
        assert_works_again(rig)

    def test_blank_memory_is_an_error_with_the_remedy(self) -> None:
        rig = grbl_rig(connect=False)
        rig.firmware.faults = GrblFaults(memory_is_blank=True)
        with pytest.raises(DeviceRefusalError) as refused:
            rig.axis.connect()
        assert refused.value.code == 7
        assert "$RST=$" in str(refused.value)
        rig.firmware.faults = GrblFaults()
        rig.reopen().home(120)
        assert_works_again(rig)

    def test_inch_mode_is_refused(self) -> None:
        rig = grbl_rig(settings={13: 1}, connect=False)
        with pytest.raises(DeviceSettingsError) as refused:
            rig.axis.connect()
        assert refused.value.settings == ("$13",)
        rig.firmware.settings[13] = 0
        rig.reopen().home(120)
        rig.firmware.settings[13] = 1
        with pytest.raises(DeviceSettingsError):
            rig.stage.home(120)

    def test_homing_that_is_switched_off_is_named(self) -> None:
        rig = grbl_rig(settings={22: 0})
        with pytest.raises(DeviceSettingsError) as refused:
            rig.stage.home(120)
        assert refused.value.settings == ("$22",)
        assert rig.plant.true_height_mm == 150.0

    @pytest.mark.parametrize(
        ("shown", "state"),
        [
            ("Hold:0", "hold"),
            ("Hold:1", "hold"),
            ("Door:1", "door"),
            ("Sleep", "unknown"),
            ("Tool", "unknown"),
            ("Check", "unknown"),
            ("Frobnicating:3", "unknown"),
        ],
    )
    @pytest.mark.parametrize("in_s", [0.0, 2.0], ids=["idle", "mid-move"])
    def test_a_state_in_which_it_does_not_move_is_named(
        self, shown: str, state: str, in_s: float
    ) -> None:
        rig = homed_grbl()

        def strike() -> None:
            rig.firmware.faults = GrblFaults(shows_state=shown)
            rig.firmware.axis.brake()

        rig.in_mid_move(strike, in_s)
        with pytest.raises(StageAlarmError) as caught:
            rig.stage.move_to(TARGET_MM, 120)
        assert caught.value.code == shown.partition(":")[0]
        assert rig.stage.state == state
        assert rig.plant.true_height_mm < TARGET_MM
        with pytest.raises(StageAlarmError):
            rig.stage.clear_alarm()
        rig.firmware.faults = GrblFaults()
        clear_home_and_work(rig)

    def test_opening_in_a_hold_says_so_and_a_reset_at_opening_is_the_way_back(self) -> None:
        rig = homed_grbl()
        rig.firmware.faults = GrblFaults(shows_state="Hold:0")
        with pytest.raises(StageAlarmError) as caught:
            rig.reopen()
        assert caught.value.code == "Hold"
        rig.firmware.faults = GrblFaults()
        rig.reopen(reset=True)
        assert not rig.stage.is_homed
        rig.stage.home(120)
        assert_works_again(rig)

    @DIALECTS
    def test_an_emergency_button_at_the_controller_is_an_alarm(self, dialect: GrblDialect) -> None:
        rig = homed_grbl(dialect)
        rig.firmware.raise_alarm(10)
        with pytest.raises(StageAlarmError) as caught:
            rig.stage.move_to(TARGET_MM, 120)
        assert caught.value.code == 10
        assert rig.stage.state == "alarm"
        assert_nothing_moves(rig, DeviceError)
        clear_home_and_work(rig)

    def test_a_work_offset_of_another_program_does_not_shift_the_stage(self) -> None:
        for mask in (1, 0):
            rig = homed_grbl(work_offset_mm=-37.5, settings={10: mask})
            assert_works_again(rig)
            assert rig.stage.position_mm() == pytest.approx(60.0, abs=0.01)

    def test_an_axis_that_counts_downwards_is_turned_round(self) -> None:
        rig = grbl_rig(direction="down", home_offset_mm=-390.0, limits_mm=[0.0, 20.0])
        rig.stage.home(120)
        # Machine position -399 is height 9 here, and the camera goes down as it counts up.
        assert rig.stage.position_mm() == pytest.approx(9.0, abs=0.01)
        before_mm = rig.plant.true_height_mm
        rig.stage.move_to(5.0, 60)
        assert rig.plant.true_height_mm == pytest.approx(before_mm + 4.0, abs=0.01)


class TestHomedEvidence:
    def test_grblhal_says_that_it_is_homed(self) -> None:
        rig = homed_grbl("grblhal")
        rig.stage.move_to(TARGET_MM, 120)
        rig.reopen()
        assert rig.stage.is_homed
        assert_works_again(rig)

    def test_grblhal_that_keeps_that_through_resets_is_not_believed(self) -> None:
        rig = homed_grbl("grblhal", settings={22: 129})
        assert not rig.reopen().is_homed

    def test_grbl_gives_no_evidence(self) -> None:
        rig = homed_grbl("grbl")
        assert not rig.reopen().is_homed
        assert rig.stage.state == "idle"
        assert_nothing_moves(rig)


class TestMotion:
    @DIALECTS
    def test_a_soft_limit_of_the_firmware_is_an_error_without_alarm(
        self, dialect: GrblDialect
    ) -> None:
        rig = homed_grbl(dialect, settings={132: 300}, home_offset_mm=309.5)
        before_mm = rig.plant.true_height_mm
        with pytest.raises(StageLimitError) as refused:
            rig.stage.move_to(320.0, 120)
        assert (refused.value.height_mm, refused.value.limits_mm) == (320.0, None)
        assert rig.stage.state == "idle"
        assert rig.plant.true_height_mm == before_mm
        assert_works_again(rig)

    @DIALECTS
    def test_a_hard_limit_in_mid_move_is_an_alarm(self, dialect: GrblDialect) -> None:
        rig = homed_grbl(dialect, settings={21: 1, 20: 0})
        rig.plant.high_switch_mm = 100.0
        with pytest.raises(StageAlarmError) as caught:
            rig.stage.move_to(TARGET_MM, 120)
        assert caught.value.code == 1
        assert rig.plant.true_height_mm == pytest.approx(100.0, abs=0.2)
        assert rig.stage.state == "alarm"
        assert_nothing_moves(rig, DeviceError)
        rig.plant.high_switch_mm = 409.5
        clear_home_and_work(rig)

    @DIALECTS
    @pytest.mark.parametrize("hard_limits", [0, 1])
    def test_lost_steps_are_invisible_until_homing_finds_them(
        self, dialect: GrblDialect, hard_limits: int
    ) -> None:
        rig = homed_grbl(dialect, settings={21: hard_limits})
        rig.plant.faults = PlantFaults(stalls_above_mm=58.0)
        assert rig.stage.move_to(60.0, 120) == pytest.approx(60.0, abs=0.01)
        assert rig.plant.true_height_mm == pytest.approx(58.0, abs=0.01)
        rig.plant.faults = PlantFaults()
        rig.stage.home(120)
        # The true height was 2 mm below the one read; a report of the creep is 0.05 mm.
        assert rig.axis.reference_error_mm == pytest.approx(-2.0, abs=0.15)
        assert "lost steps" in rig.stage.warnings[0]
        assert_works_again(rig)

    def test_homing_twice_finds_nothing_where_nothing_was_lost(self) -> None:
        rig = homed_grbl()
        rig.stage.move_to(TARGET_MM, 120)
        rig.stage.home(120)
        assert rig.axis.reference_error_mm is None or abs(rig.axis.reference_error_mm) < 0.02
        assert rig.stage.warnings == ()
        assert_works_again(rig)
