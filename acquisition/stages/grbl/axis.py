"""One axis of a Grbl 1.1 or grblHAL controller as a stage."""

from collections.abc import Callable
from threading import Event
from time import monotonic, sleep
from typing import Literal

from acquisition.bench import StageConfig
from acquisition.devices import DeviceInfo, StageState
from acquisition.errors import (
    DeviceError,
    DeviceProtocolError,
    DeviceRefusalError,
    DeviceResetError,
    DeviceSettingsError,
    DeviceTimeoutError,
    StageAlarmError,
    StageNotHomedError,
)
from acquisition.stages.grbl.codes import BLOCKED_BY_ALARM, LIMIT_PRESSED, UNLOCKS_BY_HOMING
from acquisition.stages.grbl.controller import GrblController
from acquisition.stages.grbl.envelope import work_envelope
from acquisition.stages.grbl.firmware import in_alarm_error
from acquisition.stages.grbl.motion import GrblMotion
from acquisition.stages.grbl.reference import SWITCH_TOLERANCE_MM, reference_error_mm
from acquisition.stages.grbl.setup import GrblSetup, check_settings, numbers_of
from acquisition.stages.grbl.wire import ErrorReply
from acquisition.stages.motor import MotorStage
from acquisition.stages.serial_link import open_stage_link

STATES: dict[str, StageState] = {
    "Idle": "idle",
    "Run": "moving",
    "Jog": "moving",
    "Home": "homing",
    "Hold": "hold",
    "Door": "door",
    "Alarm": "alarm",
}
UNLOCK_NEEDS_HOMING = (LIMIT_PRESSED, UNLOCKS_BY_HOMING)
"""grblHAL refuses to unlock where homing is the only way out."""


class GrblAxis(GrblMotion):
    """A `MotorAxis` that moves with jogs.

    A height is the controller's position, counted upwards, plus ``home_offset_mm``.
    `connect` begins the dialogue; the constructor sends nothing.

    Attributes
    ----------
    reference_error_mm
        True height minus the height read, as found by the last homing; None if not measured.
    """

    reference_error_mm: float | None = None
    _found: tuple[str, ...] = ()
    _beyond: tuple[str, ...] = ()
    _home_mm: float | None = None
    _setup: GrblSetup | None = None

    def connect(self, *, reset: bool = False) -> None:
        """Synchronise with the controller and check its settings; moves nothing.

        A controller that gives evidence that it is homed is believed: grblHAL's ``H:`` field,
        unless it keeps that through resets (``$22`` bit 7). Grbl 1.1 gives none.

        Parameters
        ----------
        reset
            Reset it first: for a controller in a state in which it answers no queries.

        Raises
        ------
        DeviceError
            If it does not answer, is not Grbl, or is not set as the bench file expects.
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
            return STATES.get(self.controller.status().state, "unknown")
        except StageAlarmError:
            return "alarm"
        except DeviceResetError as error:
            self._found = (*self._found, str(error))
            return STATES.get(self.controller.status().state, "unknown")
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
        """See `MotorAxis.check_reference`.

        A stage that believes it is homed creeps to where its switch should be; the error it
        finds is `reference_error_mm`. One beyond the repeatability of a switch is a warning.
        """
        if not self.is_position_known or self._home_mm is None or self._setup is None:
            return
        error_mm = reference_error_mm(
            self, self._setup, home_mm=self._home_mm, deadline=deadline, stop=stop
        )
        self.reference_error_mm = error_mm
        if error_mm is not None and abs(error_mm) > SWITCH_TOLERANCE_MM:
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
            elif refusal.code not in UNLOCK_NEEDS_HOMING:
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


def open_grbl_stage(
    config: StageConfig,
    *,
    first: Literal["nothing", "stop", "reset"] = "nothing",
    stopped: Callable[[], None] = lambda: None,
) -> MotorStage:
    """Open the port of a bench file and begin the dialogue; moves nothing.

    Parameters
    ----------
    config
        The ``[stage]`` section.
    first
        What to send before any query: ``stop`` cancels a jog that another program left
        running, ``reset`` ends a state in which the controller answers no queries.
    stopped
        Called once the stage stands, after ``stop``; what comes then may still fail.

    Raises
    ------
    StageNotStoppedError
        If it was told to stop first, and nothing says that it did.
    DeviceError
        If the port cannot be opened or the controller is not as expected.
    """
    link = open_stage_link(config, name="the Grbl stage")
    controller = GrblController(link, clock=monotonic)
    axis = GrblAxis(config, controller, clock=monotonic, sleep=sleep)
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
