"""Finds lost steps by comparing where the home switch answers with where it should."""

from collections.abc import Callable

from acquisition.errors import DeviceTimeoutError, StageAlarmError, StageLimitError
from acquisition.stages.grbl.controller import GrblController
from acquisition.stages.grbl.motion import GrblMotion
from acquisition.stages.grbl.setup import GrblSetup

__all__ = ["SWITCH_TOLERANCE_MM", "reference_error_mm"]

SWITCH_TOLERANCE_MM = 0.1
"""What a mechanical switch repeats to, and what the creep towards it resolves."""

HARD_LIMIT = 1
IDLE_REPORTS = 2
LEAVE_STEPS = 20


def reference_error_mm(
    motion: GrblMotion,
    controller: GrblController,
    setup: GrblSetup,
    *,
    home_mm: float,
    clock: Callable[[], float],
    deadline: float,
) -> float | None:
    """Height error of a homed stage: true height less the one it reads.

    The stage goes to where the last homing left it, watching the switch, then creeps at homing
    speed to where the switch answered then, and no further: what is found is a switch that
    answers early. A stage
    that lost steps *away* from its switch does not reach it, and is not measured.

    Parameters
    ----------
    motion, controller, setup
        Of a stage that stands and believes it is homed.
    home_mm
        Machine position after the last homing.
    clock
        Seconds.
    deadline
        On that clock.

    Returns
    -------
    float or None
        None where the switch did not answer, or the firmware keeps off it.

    Raises
    ------
    DeviceTimeoutError
        If it takes too long; the stage was stopped.
    DeviceError
        If the stage fails otherwise. A hard limit is no failure: it is what is looked for.
    """
    switch_mm = home_mm + setup.towards_switch * setup.pull_off_mm
    feed_mm_per_min = motion.feed_mm_per_min
    try:
        found_mm = _seek(motion, controller, home_mm, feed_mm_per_min, clock, deadline)
        if found_mm is not None:
            _leave_switch(motion, controller, setup, deadline)
        locate_feed = min(setup.locate_feed_mm_per_min, feed_mm_per_min)
        found_mm = _seek(motion, controller, switch_mm, locate_feed, clock, deadline)
        if found_mm is not None:
            _leave_switch(motion, controller, setup, deadline)
    except StageLimitError:
        return None
    except StageAlarmError as error:
        if error.code != HARD_LIMIT:
            raise
        controller.reset()
        found_mm = motion.machine_mm(controller.status())
    if found_mm is None:
        return None
    return round(motion.axis.sign * (switch_mm - found_mm), 6)


def _seek(
    motion: GrblMotion,
    controller: GrblController,
    target_mm: float,
    feed_mm_per_min: float,
    clock: Callable[[], float],
    deadline: float,
) -> float | None:
    """Machine position at which the switch answers on the way; None if it does not.

    Raises
    ------
    StageLimitError
        If the firmware keeps its jogs off the switch, as grblHAL does with hard limits.
    """
    code = motion.jog(target_mm, feed_mm_per_min)
    if code is not None:
        raise motion.refused(code)
    idle_reports = 0
    while clock() < deadline:
        report = controller.status()
        if motion.axis.letter in report.pins:
            found_mm = motion.machine_mm(report)
            motion.cancel()
            return found_mm
        # Idle may still be reported once after the ok.
        idle_reports = idle_reports + 1 if report.state == "Idle" else 0
        if idle_reports > IDLE_REPORTS:
            return None
        motion.pause()
    motion.cancel()
    raise DeviceTimeoutError(f"{controller.name}: the check of the home switch did not end")


def _leave_switch(
    motion: GrblMotion, controller: GrblController, setup: GrblSetup, deadline: float
) -> None:
    """Go back in steps of the pull-off until the switch is released."""
    for _ in range(LEAVE_STEPS):
        report = controller.status()
        if motion.axis.letter not in report.pins:
            return
        at_mm = motion.machine_mm(report)
        motion.travel(at_mm - setup.towards_switch * setup.pull_off_mm, deadline)
    raise StageAlarmError(
        f"{controller.name}: the home switch stays pressed; check the switch and its wiring",
        code="switch",
    )
