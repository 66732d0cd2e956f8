"""What a Grbl stage does after a fault: it stands still, and works again once it is homed."""

import pytest

from acquisition.errors import DeviceError, StageAlarmError, StageNotHomedError
from tests.hil_mocks.stage_rigs import GrblRig

TARGET_MM = 120.0
ROUND_MM = 0.005  # the position after a homing is known to a step of 0.004 mm

DIALECTS = pytest.mark.parametrize("dialect", ["grbl", "grblhal"])


def assert_works_again(rig: GrblRig) -> None:
    """The stage goes where it is sent, and is where it says."""
    read_back_mm = rig.stage.move_to(60.0, 120)
    assert read_back_mm == pytest.approx(60.0, abs=rig.config.tolerance_mm)
    assert rig.plant.true_height_mm == pytest.approx(read_back_mm, abs=ROUND_MM)


def assert_nothing_moves(
    rig: GrblRig,
    refusal: type[DeviceError] | tuple[type[DeviceError], ...] = (
        StageAlarmError,
        StageNotHomedError,
    ),
) -> None:
    """A move is refused, and the stage stands still for as long as one would take."""
    before_mm = rig.plant.true_height_mm
    with pytest.raises(refusal):
        rig.stage.move_to(TARGET_MM, 120)
    rig.wait(20.0)
    assert rig.plant.true_height_mm == before_mm


def clear_home_and_work(rig: GrblRig) -> None:
    """The documented way back from an alarm."""
    rig.stage.clear_alarm()
    rig.stage.home(120)
    assert_works_again(rig)
