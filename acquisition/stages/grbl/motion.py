"""Moves of one axis of a Grbl controller: jogs, arrival, settling, stopping."""

from collections.abc import Callable

from acquisition.bench import StageConfig
from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceError,
    DeviceProtocolError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
)
from acquisition.stages.grbl.controller import GrblController
from acquisition.stages.grbl.setup import height_axis
from acquisition.stages.grbl.wire import ERROR_TEXTS, JOG_CANCEL, StatusReport, jog_command

__all__ = ["GrblMotion"]

POLL_S = 0.05
"""The Grbl manual asks for at most 10 to 20 reports a second."""

START_GRACE_S = 0.5
"""Grbl may report Idle for a moment between the ok and the first step."""

STOP_TIMEOUT_S = 5.0
"""Longer than any ramp down; a stage that still moves then is reset."""

OFFSET_REPORTS = 35
"""Grbl sends the work offset at least with every 30th report."""

MOVING_STATES = ("Run", "Jog")
HOMING_DISABLED = 5
TARGET_BEYOND_TRAVEL = 15


class GrblMotion:
    """What a stage does with its controller, in machine positions of its axis.

    Parameters
    ----------
    config
        Axis, feed, settling, tolerance.
    controller
        In step, or not: a move gets it in step.
    clock, sleep
        Seconds, and how to let them pass.
    """

    def __init__(
        self,
        config: StageConfig,
        controller: GrblController,
        *,
        clock: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self.axis = height_axis(config)
        self.is_stop_wanted = False
        self._config = config
        self._controller = controller
        self._clock = clock
        self._sleep = sleep

    @property
    def feed_mm_per_min(self) -> float:
        """Feed of every move."""
        return self._config.feed_mm_per_min

    def travel(self, target_mm: float, deadline: float) -> None:
        """Jog to a machine position and wait there; a lost ``ok`` is made good once.

        Raises
        ------
        StageLimitError
            If the firmware refuses the target; nothing moved.
        DeviceTimeoutError
            If it is not there by the deadline; it may be moving.
        DeviceError
            If it stands elsewhere, or cannot move.
        """
        for is_last_try in (False, True):
            if self._must_stop():
                raise DeviceError(
                    f"{self._controller.name} was told to stop; nothing more was sent"
                )
            lost: DeviceError | None = None
            try:
                code = self.jog(target_mm, self._config.feed_mm_per_min)
                if code is not None:
                    raise self.refused(code)
            except (DeviceTimeoutError, DeviceProtocolError) as error:
                # The jog may run or not: ask where the stage is before anything is sent again.
                lost = error
            at_mm = self._wait_for_idle(target_mm, deadline)
            if abs(at_mm - target_mm) <= self._config.tolerance_mm:
                return
            if lost is not None and is_last_try and not self.is_stop_wanted:
                raise lost
            if lost is None or self.is_stop_wanted:
                raise DeviceError(
                    f"{self._controller.name} stopped at {self.axis.height_mm(at_mm):.3f} mm, "
                    f"not at {self.axis.height_mm(target_mm):.3f} mm"
                    + (", as it was told to" if self.is_stop_wanted else "; home it and try again")
                )

    def jog(self, target_mm: float, feed_mm_per_min: float) -> int | None:
        """Start a jog; the code with which it was refused, if it was."""
        answer = self._controller.command(jog_command(self.axis.letter, target_mm, feed_mm_per_min))
        if self.is_stop_wanted:
            # A stop from another thread may have come just before the jog.
            self._controller.send_realtime(JOG_CANCEL)
        return None if answer.error is None else answer.error.code

    def settle(self, height_mm: float, deadline: float) -> float:
        """Height read back after the settling time, once two readings agree.

        Raises
        ------
        DeviceTimeoutError
            If it creeps, or has crept beyond the tolerance.
        """
        before_mm = self.height_mm(self._controller.status())
        while True:
            self._sleep(self._config.settle_s)
            report = self._controller.status()
            after_mm = self.height_mm(report)
            if report.state == "Idle" and after_mm == before_mm:
                break
            before_mm = after_mm
            if self._clock() >= deadline:
                raise DeviceTimeoutError(f"it creeps, now at {after_mm:.3f} mm")
            self._sleep(POLL_S)
        if not abs(after_mm - height_mm) <= self._config.tolerance_mm + 1e-6:
            raise DeviceTimeoutError(f"it crept to {after_mm:.3f} mm")
        return after_mm

    def cancel(self) -> None:
        """Cancel the jog and wait until it stands.

        Raises
        ------
        DeviceTimeoutError
            If it does not stop; it was reset, and its position is void.
        """
        self._controller.lose_step()
        self._controller.send_realtime(JOG_CANCEL)
        deadline = self._clock() + STOP_TIMEOUT_S
        while self._controller.status().state in MOVING_STATES:
            if self._clock() >= deadline:
                self.reset_after_failure()
                raise DeviceTimeoutError(
                    f"{self._controller.name} did not stop within {STOP_TIMEOUT_S:g} s and was "
                    "reset: home it again"
                )
            self._sleep(POLL_S)

    def pause(self) -> None:
        """Let the time between two reports pass."""
        self._sleep(POLL_S)

    def reset_after_failure(self) -> None:
        """Reset; where even that fails, the error at hand says more."""
        self._controller.is_position_known = False
        try:
            self._controller.reset()
        except DeviceDisconnectedError:
            raise
        except DeviceError:
            self._controller.lose_step()

    def machine_mm(self, report: StatusReport) -> float:
        """Machine position of the axis; from work positions with the offset.

        Raises
        ------
        DeviceProtocolError
            If the controller reports neither.
        """
        index = self.axis.index
        for _ in range(OFFSET_REPORTS):
            if report.machine is not None and index < len(report.machine):
                return report.machine[index]
            offset = self._controller.offset
            if report.work is not None and offset is not None and index < len(report.work):
                return report.work[index] + offset[index]
            self._sleep(POLL_S)
            report = self._controller.status()
        raise DeviceProtocolError(
            f"{self._controller.name} reports no machine position of {self.axis.letter}; "
            "set $10=1 in a terminal"
        )

    def height_mm(self, report: StatusReport) -> float:
        """Height in a report."""
        return self.axis.height_mm(self.machine_mm(report))

    def not_ready(self, report: StatusReport) -> DeviceError:
        """Say why a controller in this state takes no move."""
        name = self._controller.name
        if report.state in MOVING_STATES:
            return DeviceError(f"{name} is moving; stop it or wait")
        self._controller.is_position_known = False
        if report.state != "Alarm":
            return StageAlarmError(
                f"{name} is in state {report.state}, in which it does not move; close its door "
                "or release its hold, then clear the alarm and home",
                code=report.state,
            )
        code = report.substate
        if code is None and self._controller.alarm is not None:
            code = self._controller.alarm.code
        return StageAlarmError(
            f"{name} is in alarm{'' if code is None else f' {code}'}; clear the alarm, then home",
            code=code,
        )

    def refused(self, code: int) -> DeviceError:
        """Say what an error code means for the stage."""
        name = self._controller.name
        text = f"error:{code} ({ERROR_TEXTS.get(code, 'see the manual')})"
        if code == TARGET_BEYOND_TRAVEL:
            return StageLimitError(
                f"{name} refuses the height with {text}; limits_mm or home_offset_mm in the "
                "bench file do not fit its settings. Nothing moved"
            )
        if code == HOMING_DISABLED:
            return DeviceError(f"{name} cannot home: {text}; set $22=1 in a terminal")
        return DeviceError(f"{name} refuses with {text}; nothing moved")

    def _must_stop(self) -> bool:
        return self.is_stop_wanted

    def _wait_for_idle(self, target_mm: float, deadline: float) -> float:
        """Machine position once two reports in turn agree that it stands."""
        still_since: float | None = None
        last_mm: float | None = None
        while True:
            report = self._controller.status()
            at_mm = self.machine_mm(report)
            now = self._clock()
            if report.state in MOVING_STATES:
                still_since = last_mm = None
            elif report.state != "Idle":
                raise self.not_ready(report)
            elif still_since is None or last_mm != at_mm:
                still_since, last_mm = now, at_mm
            elif (
                abs(at_mm - target_mm) <= self._config.tolerance_mm
                or now - still_since >= START_GRACE_S
            ):
                return at_mm
            if now >= deadline:
                where_mm = self.axis.height_mm(at_mm)
                raise DeviceTimeoutError(f"it is {report.state} at {where_mm:.3f} mm")
            self._sleep(POLL_S)
