"""The Grbl driver with a controller or mechanics at fault."""

import contextlib

import pytest

from acquisition.errors import (
    DeviceError,
    DeviceProtocolError,
    DeviceResetError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
)
from hil_mocks.grbl_firmware import GrblFaults
from hil_mocks.grbl_lines import GrblDialect
from hil_mocks.plant import PlantFaults
from tests.hil_mocks.stage_rigs import GrblRig, grbl_rig, homed_grbl
from tests.hil_mocks.test_grbl_line_faults import ROUND_MM, TARGET_MM, assert_works_again


def assert_nothing_moves(rig: GrblRig) -> None:
    before_mm = rig.plant.true_height_mm
    with pytest.raises((StageAlarmError, StageNotHomedError)):
        rig.stage.move_to(TARGET_MM, 120)
    rig.wait(20.0)
    assert rig.plant.true_height_mm == before_mm


def clear_home_and_work(rig: GrblRig) -> None:
    """The documented way back from an alarm."""
    rig.stage.clear_alarm()
    rig.stage.home(120)
    assert_works_again(rig)


DIALECTS = pytest.mark.parametrize("dialect", ["grbl", "grblhal"])


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
        with pytest.raises((StageAlarmError, DeviceResetError), match="home"):
            rig.stage.move_to(TARGET_MM, 120)
        assert rig.plant.true_height_mm < TARGET_MM
        assert not rig.stage.is_homed
        assert_nothing_moves(rig) if rig.stage.state == "alarm" else None
        clear_home_and_work(rig)

    def test_a_brown_out_when_idle_is_a_reset(self) -> None:
        rig = homed_grbl()
        rig.firmware.power_cycle()
        with pytest.raises(DeviceError):
            rig.stage.move_to(TARGET_MM, 120)
        rig.wait(2.0)
        assert_nothing_moves(rig)
        rig.stage.home(120)
        assert_works_again(rig)

    def test_a_brown_out_in_mid_move_ends_it(self) -> None:
        rig = homed_grbl()
        rig.in_mid_move(rig.firmware.power_cycle)
        with pytest.raises((DeviceResetError, DeviceTimeoutError)):
            rig.stage.move_to(TARGET_MM, 120)
        assert rig.plant.true_height_mm < TARGET_MM
        assert not rig.stage.is_homed
        rig.wait(2.0)
        assert_nothing_moves(rig)
        rig.stage.home(120)
        assert_works_again(rig)

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
        with pytest.raises(DeviceError, match=r"\$102 is 800.000, expected 250"):
            rig.stage.home(120)
        with pytest.raises(DeviceError, match=r"\$102 is 800.000, expected 250"):
            rig.reopen()
        assert rig.plant.true_height_mm == before_mm
        rig.firmware.settings.update({102: 250, 22: 1, 23: 4, 20: 1})
        rig.reopen().home(120)
        assert_works_again(rig)

    def test_blank_memory_is_an_error_with_the_remedy(self) -> None:
        rig = grbl_rig(connect=False)
        rig.firmware.faults = GrblFaults(memory_is_blank=True)
        with pytest.raises(DeviceProtocolError, match=r"error:7 .*\$RST=\$"):
            rig.stage.connect()
        rig.firmware.faults = GrblFaults()
        rig.reopen().home(120)
        assert_works_again(rig)

    def test_inch_mode_is_refused(self) -> None:
        rig = grbl_rig(settings={13: 1}, connect=False)
        with pytest.raises(DeviceError, match=r"inches; set \$13=0"):
            rig.stage.connect()
        rig.firmware.settings[13] = 0
        rig.reopen().home(120)
        rig.firmware.settings[13] = 1
        with pytest.raises(DeviceError, match="inches"):
            rig.stage.home(120)

    def test_homing_that_is_switched_off_is_named(self) -> None:
        rig = grbl_rig(settings={22: 0})
        with pytest.raises(DeviceError, match=r"\$22=1"):
            rig.stage.home(120)
        assert rig.plant.true_height_mm == 150.0

    @pytest.mark.parametrize("in_s", [0.0, 2.0], ids=["idle", "mid-move"])
    def test_a_controller_that_hangs_is_a_timeout(self, in_s: float) -> None:
        rig = homed_grbl()
        hangs = GrblFaults(hangs=True)
        rig.in_mid_move(lambda: setattr(rig.firmware, "faults", hangs), in_s)
        with pytest.raises(DeviceTimeoutError):
            rig.stage.move_to(TARGET_MM, 120)
        rig.firmware.faults = GrblFaults()
        rig.firmware.power_cycle()
        rig.wait(5.0)
        assert_nothing_moves_for_any_error(rig)
        rig.stage.home(120)
        assert_works_again(rig)

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
        with pytest.raises(StageAlarmError, match=shown.partition(":")[0]) as caught:
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
        with pytest.raises(StageAlarmError, match="Hold"):
            rig.reopen()
        rig.firmware.faults = GrblFaults()
        rig.reopen(reset=True)
        assert not rig.stage.is_homed
        rig.stage.home(120)
        assert_works_again(rig)

    @DIALECTS
    def test_an_emergency_stop_in_mid_move_halts_at_once(self, dialect: GrblDialect) -> None:
        rig = homed_grbl(dialect)
        rig.in_mid_move(rig.stage.emergency_stop)
        with pytest.raises((StageAlarmError, DeviceResetError)):
            rig.stage.move_to(TARGET_MM, 120)
        stopped_mm = rig.plant.true_height_mm
        assert stopped_mm < TARGET_MM
        assert rig.stage.state == "alarm"
        with pytest.raises(StageAlarmError, match="emergency"):
            rig.stage.home(120)
        with pytest.raises(StageNotHomedError):
            rig.stage.position_mm()
        rig.wait(5.0)
        assert rig.plant.true_height_mm == stopped_mm
        clear_home_and_work(rig)

    @DIALECTS
    def test_an_emergency_button_at_the_controller_is_an_alarm(self, dialect: GrblDialect) -> None:
        rig = homed_grbl(dialect)
        rig.firmware.raise_alarm(10)
        with pytest.raises(StageAlarmError, match="emergency stop") as caught:
            rig.stage.move_to(TARGET_MM, 120)
        assert caught.value.code == 10
        assert rig.stage.state == "alarm"
        assert_nothing_moves_for_any_error(rig)
        clear_home_and_work(rig)

    def test_a_second_move_while_one_runs_is_refused(self) -> None:
        rig = homed_grbl()
        refused: list[str] = []

        def move_too() -> None:
            with pytest.raises(DeviceError, match="moving already") as caught:
                rig.stage.move_to(20.0, 120)
            refused.append(str(caught.value))

        rig.in_mid_move(move_too)
        assert rig.stage.move_to(TARGET_MM, 120) == pytest.approx(TARGET_MM, abs=0.01)
        assert len(refused) == 1

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


def assert_nothing_moves_for_any_error(rig: GrblRig) -> None:
    before_mm = rig.plant.true_height_mm
    with pytest.raises(DeviceError):
        rig.stage.move_to(TARGET_MM, 120)
    rig.wait(20.0)
    assert rig.plant.true_height_mm == before_mm


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
    @pytest.mark.parametrize("height_mm", [float("nan"), float("inf"), -1.0, 9.99, 400.01])
    def test_a_height_that_is_none_is_refused_before_anything_is_sent(
        self, height_mm: float
    ) -> None:
        rig = homed_grbl()
        sent = len(rig.firmware.lines_received)
        with pytest.raises(StageLimitError, match="nothing moved"):
            rig.stage.move_to(height_mm, 120)
        assert len(rig.firmware.lines_received) == sent

    @DIALECTS
    def test_a_home_switch_that_is_not_found_is_an_alarm(self, dialect: GrblDialect) -> None:
        rig = grbl_rig(dialect)
        rig.plant.faults = PlantFaults(home_switch_dead=True)
        with pytest.raises(StageAlarmError, match="not found") as caught:
            rig.stage.home(120)
        assert caught.value.code == 9
        assert_nothing_moves_for_any_error(rig)
        rig.plant.faults = PlantFaults()
        rig.plant.place(30.0)  # off its end stop, by hand
        clear_home_and_work(rig)

    @DIALECTS
    def test_a_home_switch_that_is_not_released_is_an_alarm(self, dialect: GrblDialect) -> None:
        rig = grbl_rig(dialect)
        rig.plant.faults = PlantFaults(home_switch_stuck=True)
        with pytest.raises(StageAlarmError, match="not released") as caught:
            rig.stage.home(120)
        assert caught.value.code == 8
        rig.plant.faults = PlantFaults()
        clear_home_and_work(rig)

    def test_homing_that_takes_too_long_is_reset_and_stands(self) -> None:
        rig = grbl_rig()
        with pytest.raises(DeviceTimeoutError, match="home it again"):
            rig.stage.home(3.0)
        stopped_mm = rig.plant.true_height_mm
        rig.wait(10.0)
        assert rig.plant.true_height_mm == stopped_mm
        rig.stage.home(120)
        assert_works_again(rig)

    @DIALECTS
    def test_a_soft_limit_of_the_firmware_is_an_error_without_alarm(
        self, dialect: GrblDialect
    ) -> None:
        rig = homed_grbl(dialect, settings={132: 300}, home_offset_mm=309.5)
        before_mm = rig.plant.true_height_mm
        with pytest.raises(StageLimitError, match="error:15"):
            rig.stage.move_to(320.0, 120)
        assert rig.stage.state == "idle"
        assert rig.plant.true_height_mm == before_mm
        assert_works_again(rig)

    @DIALECTS
    def test_a_hard_limit_in_mid_move_is_an_alarm(self, dialect: GrblDialect) -> None:
        rig = homed_grbl(dialect, settings={21: 1, 20: 0})
        rig.plant.high_switch_mm = 100.0
        with pytest.raises(StageAlarmError, match="limit switch") as caught:
            rig.stage.move_to(TARGET_MM, 120)
        assert caught.value.code == 1
        assert rig.plant.true_height_mm == pytest.approx(100.0, abs=0.2)
        assert rig.stage.state == "alarm"
        assert_nothing_moves_for_any_error(rig)
        rig.plant.high_switch_mm = 409.5
        clear_home_and_work(rig)

    def test_a_stop_in_mid_move_keeps_the_position(self) -> None:
        rig = homed_grbl()
        rig.in_mid_move(rig.stage.stop, 3.0)
        with pytest.raises(DeviceError, match="as it was told to"):
            rig.stage.move_to(TARGET_MM, 120)
        assert rig.stage.is_homed
        assert 10.5 < rig.stage.position_mm() < TARGET_MM
        assert rig.stage.position_mm() == pytest.approx(rig.plant.true_height_mm, abs=ROUND_MM)
        assert_works_again(rig)

    def test_a_stop_while_homing_is_a_reset(self) -> None:
        rig = grbl_rig()

        def interrupt() -> None:
            raise KeyboardInterrupt

        rig.in_mid_move(interrupt, 3.0)
        with pytest.raises(KeyboardInterrupt):
            rig.stage.home(120)
        rig.stage.stop()
        stopped_mm = rig.plant.true_height_mm
        assert stopped_mm < 150.0
        rig.wait(10.0)
        assert rig.plant.true_height_mm == stopped_mm
        assert not rig.stage.is_homed
        rig.stage.home(120)
        assert_works_again(rig)

    def test_a_keyboard_interrupt_in_mid_move_leaves_a_stage_that_can_be_stopped(self) -> None:
        rig = homed_grbl()

        def interrupt() -> None:
            raise KeyboardInterrupt

        rig.in_mid_move(interrupt, 2.0)
        with pytest.raises(KeyboardInterrupt):
            rig.stage.move_to(TARGET_MM, 120)
        rig.stage.stop()
        stopped_mm = rig.plant.true_height_mm
        rig.wait(10.0)
        assert rig.plant.true_height_mm == stopped_mm < TARGET_MM
        assert rig.stage.is_homed
        assert_works_again(rig)

    def test_a_move_that_takes_too_long_is_stopped_with_its_position_kept(self) -> None:
        rig = homed_grbl()
        with pytest.raises(DeviceTimeoutError, match="it was stopped at"):
            rig.stage.move_to(TARGET_MM, 2.0)
        stopped_mm = rig.plant.true_height_mm
        rig.wait(10.0)
        assert rig.plant.true_height_mm == stopped_mm < TARGET_MM
        assert rig.stage.position_mm() == pytest.approx(stopped_mm, abs=ROUND_MM)
        assert_works_again(rig)

    def test_a_move_that_ends_short_is_an_error(self) -> None:
        rig = homed_grbl()
        rig.firmware.faults = GrblFaults(stops_short_mm=0.4)
        with pytest.raises(DeviceError, match=r"stopped at 119\.600 mm, not at 120\.000"):
            rig.stage.move_to(TARGET_MM, 120)
        assert rig.stage.is_homed
        rig.firmware.faults = GrblFaults()
        assert_works_again(rig)

    def test_a_stage_that_never_stands_is_reset(self) -> None:
        rig = homed_grbl()
        rig.in_mid_move(lambda: setattr(rig.firmware, "faults", GrblFaults(never_idle=True)))
        with pytest.raises(DeviceTimeoutError, match="did not stop"):
            rig.stage.move_to(TARGET_MM, 30)
        assert not rig.stage.is_homed
        rig.firmware.faults = GrblFaults()
        clear_home_and_work(rig)

    def test_a_stage_that_creeps_after_a_move_is_not_settled(self) -> None:
        rig = homed_grbl()
        rig.in_mid_move(lambda: setattr(rig.plant, "faults", PlantFaults(creep_mm_per_s=0.02)), 5.0)
        with pytest.raises(DeviceTimeoutError, match=r"crept|creeps|Idle"):
            rig.stage.move_to(TARGET_MM, 15)
        rig.plant.faults = PlantFaults()
        assert_works_again(rig)

    def test_backlash_does_not_show_when_heights_are_approached_from_one_side(self) -> None:
        rig = grbl_rig()
        rig.plant.faults = PlantFaults(backlash_mm=0.3)
        rig.stage.home(120)
        for height_mm in (200.0, 100.0, 99.9, 100.0, 250.0, 40.0):
            read_back_mm = rig.stage.move_to(height_mm, 120)
            # Homing came from the other flank: the play is in the home offset, and stays there.
            assert rig.plant.true_height_mm == pytest.approx(read_back_mm - 0.3, abs=0.01)

    def test_the_flank_is_taken_up_anew_after_a_stop(self) -> None:
        rig = grbl_rig()
        rig.plant.faults = PlantFaults(backlash_mm=0.3)
        rig.stage.home(120)
        rig.stage.move_to(300.0, 120)
        rig.in_mid_move(rig.stage.stop, 1.0)
        with pytest.raises(DeviceError, match="told to"):
            rig.stage.move_to(100.0, 120)
        near_mm = rig.stage.position_mm() + 0.1
        assert rig.stage.move_to(near_mm, 120) == pytest.approx(near_mm, abs=0.01)
        assert rig.plant.true_height_mm == pytest.approx(near_mm - 0.3, abs=0.01)

    def test_vibration_has_died_down_when_a_move_returns(self) -> None:
        rig = homed_grbl(settle_s=2.0)
        rig.plant.faults = PlantFaults(vibration_mm=0.2)
        read_back_mm = rig.stage.move_to(TARGET_MM, 120)
        assert rig.plant.true_height_mm == pytest.approx(read_back_mm, abs=0.01)

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
        assert rig.stage.reference_error_mm == pytest.approx(-2.0, abs=0.15)
        assert "lost steps" in rig.stage.warnings[0]
        assert_works_again(rig)

    def test_homing_twice_finds_nothing_where_nothing_was_lost(self) -> None:
        rig = homed_grbl()
        rig.stage.move_to(TARGET_MM, 120)
        rig.stage.home(120)
        assert rig.stage.reference_error_mm is None or abs(rig.stage.reference_error_mm) < 0.02
        assert rig.stage.warnings == ()
        assert_works_again(rig)

    @pytest.mark.parametrize("in_s", [0.1 * k for k in range(32)])
    def test_after_a_stop_the_stage_only_ramps_down_whenever_it_comes(self, in_s: float) -> None:
        rig = homed_grbl()
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
