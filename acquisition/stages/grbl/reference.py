"""Detects lost steps by comparing where the home switch triggers with where it should."""

from threading import Event

from acquisition.errors import DeviceTimeoutError, StageAlarmError, StageLimitError
from acquisition.stages.axis import POLL_S
from acquisition.stages.grbl.motion import GrblMotion
from acquisition.stages.grbl.setup import GrblSetup
from acquisition.stages.motor import halt, travel

SWITCH_TOLERANCE_MM = 0.1
"""Repeatability of a mechanical switch, and resolution of the creep towards it."""

HARD_LIMIT = 1
IDLE_REPORTS = 2
LEAVE_STEPS = 20


def reference_error_mm(
    axis: GrblMotion, setup: GrblSetup, *, home_mm: float, deadline: float, stop: Event
) -> float | None:
    """Height error of a homed stage: true height minus the height it reads.

    The stage goes to where the last homing left it, watching the switch, then creeps at homing
    speed to where the switch triggered then, and no further: this detects a switch that
    triggers early. A stage that lost steps *away* from its switch does not reach it, and is not
    measured.

    Parameters
    ----------
    axis, setup
        Those of a stage that is at rest and believes it is homed.
    home_mm
        Height after the last homing.
    deadline
        Time on the clock of the axis.
    stop
        Set to end the check.

    Returns
    -------
    float or None
        None if the switch did not trigger, or the firmware keeps moves away from it.

    Raises
    ------
    DeviceTimeoutError
        If it takes too long; the stage has been stopped.
    DeviceError
        If the stage fails otherwise. A hard limit is no failure: it is what the check looks for.
    """
    pull_off_mm = axis.scale.sign * setup.towards_switch * setup.pull_off_mm
    switch_mm = home_mm + pull_off_mm
    feed_mm_per_min = axis.config.feed_mm_per_min
    locate_feed = min(setup.locate_feed_mm_per_min, feed_mm_per_min)
    found_mm = None
    try:
        for target_mm, feed in ((home_mm, feed_mm_per_min), (switch_mm, locate_feed)):
            if stop.is_set():
                return None
            found_mm = _seek(axis, target_mm, feed, deadline)
            if found_mm is not None:
                _leave_switch(axis, pull_off_mm, deadline, stop)
    except StageLimitError:
        return None
    except StageAlarmError as error:
        if error.code != HARD_LIMIT:
            raise
        axis.controller.reset()
        found_mm = axis.height_mm()
    return None if found_mm is None else round(switch_mm - found_mm, 6)


def _seek(
    axis: GrblMotion, target_mm: float, feed_mm_per_min: float, deadline: float
) -> float | None:
    """Height at which the switch triggers on the way; None if it does not.

    Raises
    ------
    StageLimitError
        If the firmware keeps jogs away from the switch, as grblHAL does with hard limits.
    """
    axis.jog(target_mm, feed_mm_per_min)
    progress = axis.progress()
    idle_reports = 0
    while axis.clock() < deadline:
        report = axis.controller.status()
        if axis.scale.letter in report.pins:
            found_mm = axis.reported_mm(report)
            halt(axis, clock=axis.clock, sleep=axis.sleep)
            return found_mm
        reading = axis.checked(report)
        if reading.is_moving:
            distance_mm = abs(reading.height_mm - target_mm)
            progress.see(distance_mm, state=reading.state, height_mm=reading.height_mm)
        # Idle may still be reported once after the ok.
        idle_reports = idle_reports + 1 if report.state == "Idle" else 0
        if idle_reports > IDLE_REPORTS:
            return None
        axis.sleep(POLL_S)
    halt(axis, clock=axis.clock, sleep=axis.sleep)
    raise DeviceTimeoutError(f"{axis.name}: the check of the home switch did not end")


def _leave_switch(axis: GrblMotion, pull_off_mm: float, deadline: float, stop: Event) -> None:
    """Go back in steps of the pull-off until the switch is released."""
    for _ in range(LEAVE_STEPS):
        report = axis.controller.status()
        if axis.scale.letter not in report.pins:
            return
        travel(
            axis,
            axis.reported_mm(report) - pull_off_mm,
            tolerance_mm=axis.config.tolerance_mm,
            deadline=deadline,
            stop=stop,
        )
    raise StageAlarmError(
        f"{axis.name}: the home switch stays pressed; check the switch and its wiring",
        code="switch",
    )
