"""Moves of one axis of a Grbl controller: jogs, arrival, stopping."""

from collections.abc import Callable

from acquisition.bench import StageConfig
from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceError,
    DeviceProtocolError,
    DeviceRefusalError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
)
from acquisition.stages.axis import POLL_S, AxisReading, AxisTraits
from acquisition.stages.grbl.codes import BEYOND_TRAVEL
from acquisition.stages.grbl.controller import GrblController
from acquisition.stages.grbl.firmware import in_alarm_error, waiting_error
from acquisition.stages.grbl.setup import height_axis
from acquisition.stages.grbl.wire import JOG_CANCEL, SOFT_RESET, StatusReport, jog_command
from acquisition.stages.progress import ProgressWatch, smallest_progress_mm

START_GRACE_S = 0.5
"""Grbl may report Idle for a moment between the ok and the first step."""

OFFSET_REPORTS = 35
"""Grbl sends the work offset at least with every 30th report."""

MOVING_STATES = ("Run", "Jog")
STILL_RAMPING = (("Hold", 1), ("Door", 2), ("Door", 3), ("Door", 4))
"""Sub-states in which the motor runs: braking for a hold or a door, and going on after one,
which is ``Door:3`` on Grbl and ``Door:4`` on grblHAL."""


class GrblMotion:
    """The moving half of a `MotorAxis`.

    Parameters
    ----------
    config
        Axis, feed, tolerance.
    controller
        In step or not: a move synchronises it first.
    clock, sleep
        Time in seconds, and a function that waits.
    """

    traits = AxisTraits(
        repeat_mm=0.0,
        is_homing_cancellable=False,
        # A reset ends every motion.
        may_move_after=(DeviceTimeoutError, DeviceProtocolError),
    )

    def __init__(
        self,
        config: StageConfig,
        controller: GrblController,
        *,
        clock: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self.scale = height_axis(config)
        self.config = config
        self.controller = controller
        self.clock = clock
        self.sleep = sleep

    @property
    def name(self) -> str:
        """Its name in error messages."""
        return self.controller.name

    @property
    def is_position_known(self) -> bool:
        """See `MotorAxis.is_position_known`."""
        return self.controller.is_position_known

    @is_position_known.setter
    def is_position_known(self, value: bool) -> None:
        self.controller.is_position_known = value

    def start_move(self, height_mm: float) -> None:
        """See `MotorAxis.start_move`."""
        self.jog(height_mm, self.config.feed_mm_per_min)

    def jog(self, height_mm: float, feed_mm_per_min: float) -> None:
        """Do as `start_move` does, at another feed."""
        line = jog_command(self.scale.letter, self.scale.machine_mm(height_mm), feed_mm_per_min)
        refusal = self.controller.command(line).error
        if refusal is None:
            return
        if refusal.code == BEYOND_TRAVEL:
            raise StageLimitError(
                f"{self.name} refuses the height with {refusal.text}; nothing moved. limits_mm or "
                "home_offset_mm in the bench file does not match its settings",
                height_mm=height_mm,
                limits_mm=None,
            )
        raise DeviceRefusalError(
            f"{self.name} refuses the move with {refusal.text}; nothing moved", code=refusal.code
        )

    def wait_until_still(self, height_mm: float, deadline: float) -> float:
        """See `MotorAxis.wait_until_still`: two consecutive reports have to agree."""
        progress = self.progress()
        still_since: float | None = None
        last_mm: float | None = None
        while True:
            report = self.controller.status()
            at_mm = self.reported_mm(report)
            now = self.clock()
            if report.state in MOVING_STATES:
                still_since = last_mm = None
                progress.see(abs(at_mm - height_mm), state=report.state, height_mm=at_mm)
            elif report.state != "Idle":
                raise self.not_ready(report)
            elif still_since is None or last_mm != at_mm:
                still_since, last_mm = now, at_mm
            elif (
                abs(at_mm - height_mm) <= self.config.tolerance_mm
                or now - still_since >= START_GRACE_S
            ):
                return at_mm
            if now >= deadline:
                raise DeviceTimeoutError(f"it is {report.state} at {at_mm:.3f} mm")
            self.sleep(POLL_S)

    def height_mm(self) -> float:
        """See `MotorAxis.height_mm`."""
        return self.reported_mm(self.controller.status())

    def reading(self) -> AxisReading:
        """See `MotorAxis.reading`."""
        return self.checked(self.controller.status())

    def checked(self, report: StatusReport) -> AxisReading:
        """Return what a report says of a stage that moves or stands ready.

        Raises
        ------
        StageAlarmError
            If it does neither: a door, a hold, an alarm.
        """
        is_moving = report.state in MOVING_STATES
        if not is_moving and report.state != "Idle":
            raise self.not_ready(report)
        return AxisReading(
            height_mm=self.reported_mm(report), is_moving=is_moving, state=report.state
        )

    def is_moving(self) -> bool:
        """See `MotorAxis.is_moving`."""
        report = self.controller.status()
        return report.state in MOVING_STATES or (report.state, report.substate) in STILL_RAMPING

    def progress(self) -> ProgressWatch:
        """Return what ends a move that comes no nearer to its target."""
        return ProgressWatch(
            clock=self.clock, least_mm=smallest_progress_mm(self.config, self.traits)
        )

    def cancel(self) -> None:
        """See `MotorAxis.cancel`."""
        self.controller.lose_step()
        self.controller.send_realtime(JOG_CANCEL)

    def interrupt(self) -> None:
        """See `MotorAxis.interrupt`; a reset, which leaves an alarm."""
        self.is_position_known = False
        self.controller.lose_step()
        self.controller.send_realtime(SOFT_RESET)

    def abort(self) -> None:
        """See `MotorAxis.abort`: reset; where even that fails, the error at hand says more."""
        self.is_position_known = False
        try:
            self.controller.reset()
        except DeviceDisconnectedError:
            raise
        except DeviceError:
            self.controller.lose_step()

    def reported_mm(self, report: StatusReport) -> float:
        """Height in a report; work positions are converted with the offset.

        Raises
        ------
        DeviceProtocolError
            If the controller reports no position of the axis.
        """
        index = self.scale.index
        for _ in range(OFFSET_REPORTS):
            if report.machine is not None and index < len(report.machine):
                return self.scale.height_mm(report.machine[index])
            offset = self.controller.offset
            if report.work is not None and offset is not None and index < len(report.work):
                return self.scale.height_mm(report.work[index] + offset[index])
            self.sleep(POLL_S)
            report = self.controller.status()
        raise DeviceProtocolError(
            f"{self.name} reports no machine position for {self.scale.letter}; "
            "set $10=1 in a terminal"
        )

    def not_ready(self, report: StatusReport) -> DeviceError:
        """Return the error that says why a controller in this state accepts no move."""
        if report.state in MOVING_STATES:
            return DeviceError(f"{self.name} is moving; stop it or wait")
        self.is_position_known = False
        if report.state != "Alarm":
            return waiting_error(self.name, report.state)
        alarm = report.alarm or self.controller.alarm
        if alarm is not None:
            return in_alarm_error(self.name, alarm)
        return StageAlarmError(f"{self.name} is in alarm; clear the alarm, then home")
