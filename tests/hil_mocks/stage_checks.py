"""What a stage does after a fault: it stands still, and works again once it is homed."""

import pytest

from acquisition.errors import DeviceError, StageAlarmError, StageNotHomedError
from tests.hil_mocks.stage_rigs import StageRig

TARGET_MM = 120.0

DIALECTS = pytest.mark.parametrize("dialect", ["grbl", "grblhal"])


def assert_works_again(rig: StageRig) -> None:
    """The stage goes where it is sent, and is where it says."""
    read_back_mm = rig.stage.move_to(60.0, 120)
    assert read_back_mm == pytest.approx(60.0, abs=rig.config.tolerance_mm)
    assert rig.plant.true_height_mm == pytest.approx(read_back_mm, abs=rig.round_mm)


def assert_nothing_moves(
    rig: StageRig,
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


def assert_stands(rig: StageRig) -> float:
    """Height at which the stage stands, and still does after a while."""
    at_mm = rig.plant.true_height_mm
    rig.wait(10.0)
    assert rig.plant.true_height_mm == at_mm
    return at_mm


def clear_home_and_work(rig: StageRig) -> None:
    """The documented way back from an alarm."""
    rig.stage.clear_alarm()
    rig.stage.home(120)
    assert_works_again(rig)
