"""The Grbl driver's moves: limits, stops, homing, and mechanics at fault."""

import contextlib

import pytest

from acquisition.errors import (
    DeviceError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
)
from hil_mocks.stages.grbl import GrblFaults
from hil_mocks.stages.grbl_lines import GrblDialect
from hil_mocks.stages.plant import PlantFaults
from tests.hil_mocks.grbl_checks import (
    DIALECTS,
    ROUND_MM,
    TARGET_MM,
    assert_nothing_moves,
    assert_works_again,
    clear_home_and_work,
)
from tests.hil_mocks.stage_rigs import grbl_rig, homed_grbl


@pytest.mark.parametrize("height_mm", [float("nan"), float("inf"), -1.0, 9.99, 400.01])
def test_a_height_that_is_none_is_refused_before_anything_is_sent(height_mm: float) -> None:
    rig = homed_grbl()
    sent = len(rig.firmware.lines_received)
    with pytest.raises(StageLimitError, match="nothing moved"):
        rig.stage.move_to(height_mm, 120)
    assert len(rig.firmware.lines_received) == sent


@DIALECTS
def test_a_home_switch_that_is_not_found_is_an_alarm(dialect: GrblDialect) -> None:
    rig = grbl_rig(dialect)
    rig.plant.faults = PlantFaults(home_switch_dead=True)
    with pytest.raises(StageAlarmError, match="not found") as caught:
        rig.stage.home(120)
    assert caught.value.code == 9
    assert_nothing_moves(rig, DeviceError)
    rig.plant.faults = PlantFaults()
    rig.plant.place(30.0)  # off its end stop, by hand
    clear_home_and_work(rig)


@DIALECTS
def test_a_home_switch_that_is_not_released_is_an_alarm(dialect: GrblDialect) -> None:
    rig = grbl_rig(dialect)
    rig.plant.faults = PlantFaults(home_switch_stuck=True)
    with pytest.raises(StageAlarmError, match="not released") as caught:
        rig.stage.home(120)
    assert caught.value.code == 8
    rig.plant.faults = PlantFaults()
    clear_home_and_work(rig)


def test_homing_that_takes_too_long_is_reset_and_stands() -> None:
    rig = grbl_rig()
    with pytest.raises(DeviceTimeoutError, match="home it again"):
        rig.stage.home(3.0)
    stopped_mm = rig.plant.true_height_mm
    rig.wait(10.0)
    assert rig.plant.true_height_mm == stopped_mm
    rig.stage.home(120)
    assert_works_again(rig)


@DIALECTS
def test_a_soft_limit_of_the_firmware_is_an_error_without_alarm(dialect: GrblDialect) -> None:
    rig = homed_grbl(dialect, settings={132: 300}, home_offset_mm=309.5)
    before_mm = rig.plant.true_height_mm
    with pytest.raises(StageLimitError, match="error:15"):
        rig.stage.move_to(320.0, 120)
    assert rig.stage.state == "idle"
    assert rig.plant.true_height_mm == before_mm
    assert_works_again(rig)


@DIALECTS
def test_a_hard_limit_in_mid_move_is_an_alarm(dialect: GrblDialect) -> None:
    rig = homed_grbl(dialect, settings={21: 1, 20: 0})
    rig.plant.high_switch_mm = 100.0
    with pytest.raises(StageAlarmError, match="limit switch") as caught:
        rig.stage.move_to(TARGET_MM, 120)
    assert caught.value.code == 1
    assert rig.plant.true_height_mm == pytest.approx(100.0, abs=0.2)
    assert rig.stage.state == "alarm"
    assert_nothing_moves(rig, DeviceError)
    rig.plant.high_switch_mm = 409.5
    clear_home_and_work(rig)


def test_a_stop_in_mid_move_keeps_the_position() -> None:
    rig = homed_grbl()
    rig.in_mid_move(rig.stage.stop, 3.0)
    with pytest.raises(DeviceError, match="as it was told to"):
        rig.stage.move_to(TARGET_MM, 120)
    assert rig.stage.is_homed
    assert 10.5 < rig.stage.position_mm() < TARGET_MM
    assert rig.stage.position_mm() == pytest.approx(rig.plant.true_height_mm, abs=ROUND_MM)
    assert_works_again(rig)


def test_a_stop_while_homing_is_a_reset() -> None:
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


def test_a_keyboard_interrupt_in_mid_move_leaves_a_stage_that_can_be_stopped() -> None:
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


def test_a_move_that_takes_too_long_is_stopped_with_its_position_kept() -> None:
    rig = homed_grbl()
    with pytest.raises(DeviceTimeoutError, match="it was stopped at"):
        rig.stage.move_to(TARGET_MM, 2.0)
    stopped_mm = rig.plant.true_height_mm
    rig.wait(10.0)
    assert rig.plant.true_height_mm == stopped_mm < TARGET_MM
    assert rig.stage.position_mm() == pytest.approx(stopped_mm, abs=ROUND_MM)
    assert_works_again(rig)


def test_a_move_that_ends_short_is_an_error() -> None:
    rig = homed_grbl()
    rig.firmware.faults = GrblFaults(stops_short_mm=0.4)
    with pytest.raises(DeviceError, match=r"stopped at 119\.600 mm, not at 120\.000"):
        rig.stage.move_to(TARGET_MM, 120)
    assert rig.stage.is_homed
    rig.firmware.faults = GrblFaults()
    assert_works_again(rig)


def test_a_stage_that_never_stands_is_reset() -> None:
    rig = homed_grbl()
    rig.in_mid_move(lambda: setattr(rig.firmware, "faults", GrblFaults(never_idle=True)))
    with pytest.raises(DeviceTimeoutError, match="did not stop"):
        rig.stage.move_to(TARGET_MM, 30)
    assert not rig.stage.is_homed
    rig.firmware.faults = GrblFaults()
    clear_home_and_work(rig)


def test_a_stage_that_creeps_after_a_move_is_not_settled() -> None:
    rig = homed_grbl()
    rig.in_mid_move(lambda: setattr(rig.plant, "faults", PlantFaults(creep_mm_per_s=0.02)), 5.0)
    with pytest.raises(DeviceTimeoutError, match=r"crept|creeps|Idle"):
        rig.stage.move_to(TARGET_MM, 15)
    rig.plant.faults = PlantFaults()
    assert_works_again(rig)


def test_backlash_does_not_show_when_heights_are_approached_from_one_side() -> None:
    rig = grbl_rig()
    rig.plant.faults = PlantFaults(backlash_mm=0.3)
    rig.stage.home(120)
    for height_mm in (200.0, 100.0, 99.9, 100.0, 250.0, 40.0):
        read_back_mm = rig.stage.move_to(height_mm, 120)
        # Homing came from the other flank: the play is in the home offset, and stays there.
        assert rig.plant.true_height_mm == pytest.approx(read_back_mm - 0.3, abs=0.01)


def test_the_flank_is_taken_up_anew_after_a_stop() -> None:
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


def test_vibration_has_died_down_when_a_move_returns() -> None:
    rig = homed_grbl(settle_s=2.0)
    rig.plant.faults = PlantFaults(vibration_mm=0.2)
    read_back_mm = rig.stage.move_to(TARGET_MM, 120)
    assert rig.plant.true_height_mm == pytest.approx(read_back_mm, abs=0.01)


@DIALECTS
@pytest.mark.parametrize("hard_limits", [0, 1])
def test_lost_steps_are_invisible_until_homing_finds_them(
    dialect: GrblDialect, hard_limits: int
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


def test_homing_twice_finds_nothing_where_nothing_was_lost() -> None:
    rig = homed_grbl()
    rig.stage.move_to(TARGET_MM, 120)
    rig.stage.home(120)
    assert rig.stage.reference_error_mm is None or abs(rig.stage.reference_error_mm) < 0.02
    assert rig.stage.warnings == ()
    assert_works_again(rig)


@pytest.mark.parametrize("in_s", [0.1 * k for k in range(32)])
def test_after_a_stop_the_stage_only_ramps_down_whenever_it_comes(in_s: float) -> None:
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
