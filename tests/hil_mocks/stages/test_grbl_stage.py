"""The Grbl driver's moves: limits, stops, homing, and mechanics at fault."""

import pytest

from acquisition.errors import (
    DeviceError,
    StageAlarmError,
    StageLimitError,
)
from hil_mocks.stages.grbl_protocol import GrblDialect
from hil_mocks.stages.plant import PlantFaults
from tests.hil_mocks.stage_checks import (
    DIALECTS,
    TARGET_MM,
    assert_nothing_moves,
    assert_works_again,
    clear_home_and_work,
)
from tests.hil_mocks.stage_rigs import grbl_rig, homed_grbl


@DIALECTS
def test_a_home_switch_that_is_not_released_is_an_alarm(dialect: GrblDialect) -> None:
    rig = grbl_rig(dialect)
    rig.plant.faults = PlantFaults(home_switch_stuck=True)
    with pytest.raises(StageAlarmError) as caught:
        rig.stage.home(120)
    assert caught.value.code == 8
    rig.plant.faults = PlantFaults()
    clear_home_and_work(rig)


@DIALECTS
def test_a_soft_limit_of_the_firmware_is_an_error_without_alarm(dialect: GrblDialect) -> None:
    rig = homed_grbl(dialect, settings={132: 300}, home_offset_mm=309.5)
    before_mm = rig.plant.true_height_mm
    with pytest.raises(StageLimitError) as refused:
        rig.stage.move_to(320.0, 120)
    assert (refused.value.height_mm, refused.value.limits_mm) == (320.0, None)
    assert rig.stage.state == "idle"
    assert rig.plant.true_height_mm == before_mm
    assert_works_again(rig)


@DIALECTS
def test_a_hard_limit_in_mid_move_is_an_alarm(dialect: GrblDialect) -> None:
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
    dialect: GrblDialect, hard_limits: int
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


def test_homing_twice_finds_nothing_where_nothing_was_lost() -> None:
    rig = homed_grbl()
    rig.stage.move_to(TARGET_MM, 120)
    rig.stage.home(120)
    assert rig.axis.reference_error_mm is None or abs(rig.axis.reference_error_mm) < 0.02
    assert rig.stage.warnings == ()
    assert_works_again(rig)
