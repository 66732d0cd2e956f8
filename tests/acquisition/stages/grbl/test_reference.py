"""The check of the home switch, on a stage that creeps 0.02 mm from report to report."""

from threading import Event
from typing import Any

import pytest

from acquisition.errors import DeviceTimeoutError, StageAlarmError
from acquisition.stages.grbl import reference_error_mm
from acquisition.stages.grbl_setup import GrblSetup
from tests.acquisition.scripted_grbl import Answer, CreepingController, axis_of

SETUP = GrblSetup(
    is_homing_enabled=True,
    keeps_homed_on_reset=False,
    towards_switch=1.0,
    pull_off_mm=1.5,
    locate_feed_mm_per_min=25.0,
)
HOME_MM = 18.5
"""After homing the stage stands the pull-off below its switch, which is at 20 mm: machine 0."""


def error_of(controller: CreepingController, deadline: float = 1000.0) -> float | None:
    return reference_error_mm(
        axis_of(controller), SETUP, home_mm=HOME_MM, deadline=deadline, stop=Event()
    )


@pytest.mark.parametrize("lost_mm", [0.0, 0.1, 0.4])
def test_lost_steps_are_what_the_switch_is_off_by(lost_mm: float) -> None:
    # The stage stands higher by what it lost going down: its switch answers earlier.
    controller = CreepingController(-30.0, lambda z_mm: z_mm >= -lost_mm - 1e-9)
    assert error_of(controller) == pytest.approx(lost_mm, abs=0.02)
    assert not controller.pressed(controller.z_mm)


def test_a_switch_beyond_where_it_should_be_is_not_found() -> None:
    assert error_of(CreepingController(-30.0, lambda z_mm: z_mm >= 0.2)) is None


def test_a_switch_that_is_reached_on_the_way_home_already_is_found_as_well() -> None:
    controller = CreepingController(-30.0, lambda z_mm: z_mm >= -4.0)
    assert error_of(controller) == pytest.approx(4.0, abs=0.02)
    # Once at the feed of a move, once at that of homing.
    seeks = [line for line in controller.sent if isinstance(line, str) and "F25" in line]
    assert len(seeks) == 1


def test_a_firmware_that_keeps_off_its_switch_tells_nothing() -> None:
    controller = CreepingController(-30.0, lambda _: False)
    controller.refuse_with = Answer(15)
    assert error_of(controller) is None


class Alarmed(CreepingController):
    """Raises an alarm when its switch answers, as with hard limits on."""

    def __init__(self, code: int) -> None:
        super().__init__(-30.0, lambda z_mm: z_mm >= -0.3)
        self._code = code
        self.was_reset = False

    def status(self) -> Any:
        report = super().status()
        if report.pins and not self.was_reset:
            raise StageAlarmError(f"ALARM:{self._code}", code=self._code)
        return report

    def reset(self) -> None:
        super().reset()
        self.was_reset = True


def test_a_hard_limit_is_what_is_looked_for() -> None:
    controller = Alarmed(1)
    assert error_of(controller) == pytest.approx(0.3, abs=0.02)
    assert controller.was_reset


def test_another_alarm_is_an_alarm() -> None:
    with pytest.raises(StageAlarmError) as alarmed:
        error_of(Alarmed(2))
    assert alarmed.value.code == 2


def test_a_check_that_takes_too_long_stops_the_stage() -> None:
    controller = CreepingController(-300.0, lambda _: False)
    with pytest.raises(DeviceTimeoutError):
        error_of(controller, deadline=2.0)
    stands_mm = controller.z_mm
    controller.status()
    assert controller.z_mm == stands_mm


def test_a_switch_that_stays_pressed_is_named() -> None:
    controller = CreepingController(-2.0, lambda _: True)
    with pytest.raises(StageAlarmError) as stuck:
        error_of(controller)
    assert stuck.value.code == "switch"
