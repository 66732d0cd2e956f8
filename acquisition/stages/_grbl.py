"""One axis of a Grbl 1.1 or grblHAL controller as a stage: jogs, arrival, stopping, lost steps."""

from collections.abc import Callable
from threading import Event
from time import monotonic, sleep
from typing import Literal

from acquisition.bench import StageConfig
from acquisition.devices import DeviceInfo, StageState
from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceError,
    DeviceProtocolError,
    DeviceRefusalError,
    DeviceResetError,
    DeviceSettingsError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
)
from acquisition.stages._grbl_setup import (
    GrblSetup,
    check_settings,
    height_axis,
    numbers_of,
    work_envelope,
)
from acquisition.stages._motor import (
    POLL_S,
    AxisReading,
    AxisTraits,
    MotorStage,
    ProgressWatch,
    halt,
    smallest_progress_mm,
    travel,
)
from acquisition.stages._serial_link import open_stage_link
from acquisition.stages.grbl_controller import GrblController, in_alarm_error, waiting_error
from acquisition.stages.grbl_wire import (
    BEYOND_TRAVEL,
    BLOCKED_BY_ALARM,
    JOG_CANCEL,
    LIMIT_PRESSED,
    SOFT_RESET,
    UNLOCKS_BY_HOMING,
    ErrorReply,
    StatusReport,
    jog_command,
)

_START_GRACE_S = 0.5
"""Grbl may report Idle for a moment between the ok and the first step."""

OFFSET_REPORTS = 35
"""Grbl sends the work offset at least with every 30th report."""

_MOVING_STATES = ("Run", "Jog")
_STILL_RAMPING = (("Hold", 1), ("Door", 2), ("Door", 3), ("Door", 4))
"""Sub-states in which the motor runs: braking for a hold or a door, and going on after one,
which is ``Door:3`` on Grbl and ``Door:4`` on grblHAL."""

_SWITCH_TOLERANCE_MM = 0.1
"""Repeatability of a mechanical switch, and resolution of the creep towards it."""

_HARD_LIMIT = 1
_IDLE_REPORTS = 2
_LEAVE_STEPS = 20

_STATES: dict[str, StageState] = {
    "Idle": "idle",
    "Run": "moving",
    "Jog": "moving",
    "Home": "homing",
    "Hold": "hold",
    "Door": "door",
    "Alarm": "alarm",
}
_UNLOCK_NEEDS_HOMING = (LIMIT_PRESSED, UNLOCKS_BY_HOMING)
"""grblHAL refuses to unlock where homing is the only way out."""


class _GrblAxis:
    """A `MotorAxis` that moves with jogs; `connect` begins the dialogue.

    A height is the controller's position, counted upwards, plus ``home_offset_mm``.
    ``reference_error_mm`` is the true height minus the height read, as found by the last homing.
    """

    traits = AxisTraits(
        repeat_mm=0.0,
        is_homing_cancellable=False,
        # A reset ends every motion.
        may_move_after=(DeviceTimeoutError, DeviceProtocolError),
    )

    reference_error_mm: float | None = None
    _found: tuple[str, ...] = ()
    _beyond: tuple[str, ...] = ()
    _home_mm: float | None = None
    _setup: GrblSetup | None = None

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
                "home_offset_mm in the bench file does not match the controller's settings",
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
            if report.state in _MOVING_STATES:
                still_since = last_mm = None
                progress.see(abs(at_mm - height_mm), state=report.state, height_mm=at_mm)
            elif report.state != "Idle":
                raise self.not_ready(report)
            elif still_since is None or last_mm != at_mm:
                still_since, last_mm = now, at_mm
            elif (
                abs(at_mm - height_mm) <= self.config.tolerance_mm
                or now - still_since >= _START_GRACE_S
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
        """Return what a report says of a stage that moves or stands ready."""
        is_moving = report.state in _MOVING_STATES
        if not is_moving and report.state != "Idle":
            raise self.not_ready(report)
        return AxisReading(
            height_mm=self.reported_mm(report), is_moving=is_moving, state=report.state
        )

    def is_moving(self) -> bool:
        """See `MotorAxis.is_moving`."""
        report = self.controller.status()
        return report.state in _MOVING_STATES or (report.state, report.substate) in _STILL_RAMPING

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
        """Height in a report; work positions are converted with the offset."""
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
        if report.state in _MOVING_STATES:
            return DeviceError(f"{self.name} is moving; stop it or wait")
        self.is_position_known = False
        if report.state != "Alarm":
            return waiting_error(self.name, report.state)
        alarm = report.alarm or self.controller.alarm
        if alarm is not None:
            return in_alarm_error(self.name, alarm)
        return StageAlarmError(f"{self.name} is in alarm; clear the alarm, then home")

    def connect(self, *, reset: bool = False) -> None:
        """Synchronise with the controller and check its settings; moves nothing.

        A controller that gives evidence that it is homed is believed: grblHAL's ``H:`` field,
        unless it keeps that through resets (``$22`` bit 7). Grbl 1.1 gives none.
        """
        if reset:
            self.controller.reset()
        else:
            self.controller.get_in_step(may_boot=True)
        setup = self._read_setup()
        firmware = self.controller.firmware
        if firmware is not None and firmware.family == "grblHAL":
            report = self.controller.status(full=True)
            self.is_position_known = (
                report.state == "Idle"
                and report.is_homed(self.scale.letter)
                and not setup.keeps_homed_on_reset
            )

    @property
    def info(self) -> DeviceInfo:
        """See `Stage.info`."""
        firmware = self.controller.firmware
        if firmware is None:
            return DeviceInfo(vendor="", model="", serial_number="", firmware="", driver="grbl")
        return DeviceInfo(
            vendor="Grbl",
            model=f"{firmware.family} {firmware.board}".strip(),
            serial_number=firmware.user_text,
            firmware=firmware.version,
            driver="grbl",
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """See `MotorAxis.warnings`: what was found since the last homing, alarm and travel."""
        alarm = self.controller.alarm
        told = () if alarm is None else (str(in_alarm_error(self.name, alarm)),)
        return (*self._found, *told, *self._beyond)

    @property
    def homing_s(self) -> float:
        """See `HomingStage`: by the settings as they were read last."""
        return 0.0 if self._setup is None else self._setup.homing_s

    def state(self) -> StageState:
        """See `MotorAxis.state`."""
        try:
            return _STATES.get(self.controller.status().state, "unknown")
        except StageAlarmError:
            return "alarm"
        except DeviceResetError as error:
            self._found = (*self._found, str(error))
            return _STATES.get(self.controller.status().state, "unknown")
        except (DeviceProtocolError, DeviceTimeoutError):
            if self.controller.alarm is None:
                raise
            return "alarm"  # in a critical alarm Grbl answers nothing

    def known_height_mm(self) -> float | None:
        """See `MotorAxis.known_height_mm`."""
        report = self.controller.status()
        return self.reported_mm(report) if self.is_position_known else None

    def travel_height_mm(self) -> float | None:
        """See `TravellingStage`: from the last report, so that nothing is sent."""
        report = self.controller.last_report
        if report is None or report.machine is None:
            return None
        return self.scale.height_mm(report.machine[self.scale.index])

    def ready_height_mm(self) -> float:
        """See `MotorAxis.ready_height_mm`."""
        report = self.controller.status()
        # Where homing is required, Grbl starts in alarm, with nothing to clear.
        is_start = report.state == "Alarm" and self.controller.alarm is None
        if not self.is_position_known and (report.state == "Idle" or is_start):
            raise StageNotHomedError(f"{self.name} must be homed before it moves")
        if report.state != "Idle":
            raise self.not_ready(report)
        return self.reported_mm(report)

    def prepare_homing(self) -> None:
        """See `MotorAxis.prepare_homing`."""
        if not self.is_position_known:
            self._home_mm = None
        self.controller.get_in_step(may_boot=True)
        if not self._read_setup().is_homing_enabled:
            raise DeviceSettingsError(
                f"{self.name} cannot home because homing is not enabled; set $22=1 in a terminal",
                settings=("$22",),
            )
        self.reference_error_mm, self._found = None, ()

    def check_reference(self, deadline: float, stop: Event) -> None:
        """See `MotorAxis.check_reference`: a homed stage creeps to where its switch should be."""
        if not self.is_position_known or self._home_mm is None or self._setup is None:
            return
        error_mm = reference_error_mm(
            self, self._setup, home_mm=self._home_mm, deadline=deadline, stop=stop
        )
        self.reference_error_mm = error_mm
        if error_mm is not None and abs(error_mm) > _SWITCH_TOLERANCE_MM:
            self._found = (
                f"the home switch triggered {abs(error_mm):.2f} mm from where it should: the stage "
                "has lost steps, and heights since the previous homing are wrong",
            )

    def find_reference(self, deadline: float) -> None:
        """See `MotorAxis.find_reference`."""
        line = "$H" + (self.scale.letter if self.config.homing == "single_axis" else "")
        refusal = self.controller.command(line, max(deadline - self.clock(), 0.0)).error
        if refusal is not None:
            raise self._refused(refusal)
        report = self.controller.status()
        if report.state != "Idle":
            raise self.not_ready(report)
        self.controller.alarm = None
        self._home_mm = self.reported_mm(report)

    def refresh_warnings(self) -> None:
        """See `MotorAxis.refresh_warnings`; Grbl has none of its own."""

    def clear_alarm(self) -> None:
        """See `MotorAxis.clear_alarm`: a reset and an unlock. The position is lost: home next."""
        self.controller.reset()
        report = self.controller.status()
        if report.state == "Alarm":
            refusal = self.controller.command("$X").error
            if refusal is None:
                self.controller.alarm = None
            elif refusal.code not in _UNLOCK_NEEDS_HOMING:
                raise self._refused(refusal)
        elif report.state != "Idle":
            raise self.not_ready(report)

    def close(self) -> None:
        """See `MotorAxis.close`."""
        self.controller.close()

    def _read_setup(self) -> GrblSetup:
        settings, firmware = self.controller.settings(), self.controller.firmware
        self._setup = check_settings(settings, self.config, name=self.name)
        if firmware is not None:
            envelope = work_envelope(
                numbers_of(settings),
                self.config,
                family=firmware.family,
                sets_origin=firmware.sets_origin,
            )
            fault = None if envelope is None else envelope.fault(self.config.limits_mm)
            self._beyond = () if fault is None else (f"{fault.found}: {fault.remedy}",)
        return self._setup

    def _refused(self, refusal: ErrorReply) -> DeviceError:
        alarm = self.controller.alarm
        if refusal.code == BLOCKED_BY_ALARM and alarm is not None:
            return in_alarm_error(self.name, alarm)
        return DeviceRefusalError(
            f"{self.name} refuses the command with {refusal.text}; nothing moved",
            code=refusal.code,
        )


def reference_error_mm(
    axis: _GrblAxis, setup: GrblSetup, *, home_mm: float, deadline: float, stop: Event
) -> float | None:
    """Height error of a homed stage: true height minus the height it reads.

    The stage goes to where the last homing left it, ``home_mm``, watching the switch, then creeps
    at homing speed to where the switch triggered then, and no further: this detects a switch that
    triggers early. A stage that lost steps *away* from its switch does not reach it, and is not
    measured: None, as where the firmware keeps moves away from the switch. ``deadline`` is a time
    on the clock of the axis; ``stop`` is set to end the check. A hard limit is no failure: it is
    what the check looks for.
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
        if error.code != _HARD_LIMIT:
            raise
        axis.controller.reset()
        found_mm = axis.height_mm()
    return None if found_mm is None else round(switch_mm - found_mm, 6)


def _seek(
    axis: _GrblAxis, target_mm: float, feed_mm_per_min: float, deadline: float
) -> float | None:
    """Height at which the switch triggers on the way; None if it does not."""
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
        if idle_reports > _IDLE_REPORTS:
            return None
        axis.sleep(POLL_S)
    halt(axis, clock=axis.clock, sleep=axis.sleep)
    raise DeviceTimeoutError(f"{axis.name}: the check of the home switch did not end")


def _leave_switch(axis: _GrblAxis, pull_off_mm: float, deadline: float, stop: Event) -> None:
    """Go back in steps of the pull-off until the switch is released."""
    for _ in range(_LEAVE_STEPS):
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


def open_grbl_stage(
    config: StageConfig,
    *,
    first: Literal["nothing", "stop", "reset"] = "nothing",
    stopped: Callable[[], None] = lambda: None,
) -> MotorStage:
    """Open the port of a bench file and begin the dialogue; moves nothing.

    ``first`` is sent before any query: ``stop`` cancels a jog that another program left running,
    ``reset`` ends a state without answers. ``stopped`` is called once the stage stands.
    """
    link = open_stage_link(config, name="the Grbl stage")
    controller = GrblController(link, clock=monotonic)
    axis = _GrblAxis(config, controller, clock=monotonic, sleep=sleep)
    stage = MotorStage(config, axis, clock=monotonic, sleep=sleep)
    try:
        if first == "stop":
            stage.stop_first()
            stopped()
        axis.connect(reset=first == "reset")
    except BaseException:
        stage.close()
        raise
    return stage
