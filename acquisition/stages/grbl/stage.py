"""A height stage on a Grbl 1.1 or grblHAL controller."""

from collections.abc import Callable
from time import monotonic, sleep
from typing import Literal

from acquisition.bench import StageConfig
from acquisition.devices import DeviceInfo, StageState
from acquisition.errors import (
    DeviceError,
    DeviceProtocolError,
    DeviceResetError,
    DeviceTimeoutError,
    StageAlarmError,
    StageNotHomedError,
)
from acquisition.stages.grbl.controller import GrblController
from acquisition.stages.grbl.motion import GrblMotion
from acquisition.stages.grbl.reference import SWITCH_TOLERANCE_MM, reference_error_mm
from acquisition.stages.grbl.setup import GrblSetup, check_settings
from acquisition.stages.grbl.wire import JOG_CANCEL, SOFT_RESET
from acquisition.stages.serial_link import SerialLink, open_stage_link
from acquisition.stages.travel import approach_heights_mm, refuse_beyond_limits

__all__ = ["GrblStage", "open_grbl_stage"]

STATES: dict[str, StageState] = {
    "Idle": "idle",
    "Run": "moving",
    "Jog": "moving",
    "Home": "homing",
    "Hold": "hold",
    "Door": "door",
    "Alarm": "alarm",
}
UNLOCK_NEEDS_HOMING = (45, 46)
"""grblHAL refuses to unlock where homing is the only way on."""

HOMING_DISABLED = 5


class GrblStage:
    """Moves with jogs, and believes only what it reads back.

    A height is the controller's position, turned to point up, plus ``home_offset_mm``.
    `connect` begins the dialogue; the constructor sends nothing.

    Parameters
    ----------
    config
        Axis, limits, feed, settling, tolerance, side of approach.
    link
        Open link; `close` gives it back.
    clock, sleep
        Seconds, and how to let them pass.

    Attributes
    ----------
    reference_error_mm
        True height less the one read, as the last homing found it; None where not measured.
    warnings
        What the operator should know; anew with each homing.
    """

    def __init__(
        self,
        config: StageConfig,
        link: SerialLink,
        *,
        clock: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self.reference_error_mm: float | None = None
        self.warnings: tuple[str, ...] = ()
        self._config = config
        self._clock = clock
        self._controller = GrblController(link, clock=clock)
        self._motion = GrblMotion(config, self._controller, clock=clock, sleep=sleep)
        self._home_position_mm: float | None = None
        self._is_flank_taken = False
        self._is_homing = False
        self._is_moving = False
        self._is_emergency = False

    def connect(self, *, reset: bool = False) -> None:
        """Get in step with the controller and check its settings; moves nothing.

        A controller that gives evidence that it is homed is believed: grblHAL's ``H:`` field,
        unless it keeps that through resets (``$22`` bit 7). Grbl 1.1 gives none.

        Parameters
        ----------
        reset
            Reset it first: for a controller in a state in which it answers no question.

        Raises
        ------
        DeviceError
            If it does not answer, is not Grbl, or is not set as the bench file expects.
        """
        if reset:
            self._controller.reset()
        else:
            self._controller.get_in_step(may_boot=True)
        setup = self._read_setup()
        firmware = self._controller.firmware
        if firmware is not None and firmware.family == "grblHAL":
            report = self._controller.status(full=True)
            self._controller.is_position_known = (
                report.state == "Idle"
                and report.is_homed(self._motion.axis.letter)
                and not setup.keeps_homed_on_reset
            )

    @property
    def info(self) -> DeviceInfo:
        """See `Stage.info`."""
        firmware = self._controller.firmware
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
    def limits_mm(self) -> tuple[float, float]:
        """See `Stage.limits_mm`."""
        return self._config.limits_mm

    @property
    def is_homed(self) -> bool:
        """See `Stage.is_homed`."""
        return self._controller.is_position_known and not self._is_emergency

    @property
    def state(self) -> StageState:
        """See `Stage.state`."""
        if self._is_emergency:
            return "alarm"
        try:
            return STATES.get(self._controller.status().state, "unknown")
        except StageAlarmError:
            return "alarm"
        except DeviceResetError as error:
            self.warnings = (*self.warnings, str(error))
            return STATES.get(self._controller.status().state, "unknown")
        except (DeviceProtocolError, DeviceTimeoutError):
            if self._controller.alarm is None:
                raise
            return "alarm"  # in a critical alarm Grbl answers nothing

    def position_mm(self) -> float:
        """See `Stage.position_mm`.

        Raises
        ------
        StageNotHomedError
            If the position is not known.
        """
        report = None if self._is_emergency else self._controller.status()
        if report is None or not self.is_homed:
            raise StageNotHomedError(f"{self._controller.name} does not know its height: home it")
        return self._motion.height_mm(report)

    def travel_height_mm(self) -> float | None:
        """See `TravellingStage`: from the last report, so that nothing is sent."""
        report = self._controller.last_report
        index = self._motion.axis.index
        if report is None or report.machine is None or not self.is_homed:
            return None
        return self._motion.axis.height_mm(report.machine[index])

    def home(self, timeout_s: float) -> None:
        """See `Stage.home`.

        A stage that believes it is homed first creeps to where its switch should be; what it
        finds there is `reference_error_mm`. Beyond what a switch repeats to, it is a warning:
        the stage has lost steps.
        """
        self._refuse_emergency()
        deadline = self._clock() + timeout_s
        was_homed = self.is_homed
        self._controller.get_in_step(may_boot=True)
        setup = self._read_setup()
        if not setup.is_homing_enabled:
            raise self._motion.refused(HOMING_DISABLED)
        self.reference_error_mm, self.warnings = None, ()
        if was_homed and self.is_homed and self._home_position_mm is not None:
            self._check_reference(setup, self._home_position_mm, deadline)
        self._controller.is_position_known = False
        self._is_flank_taken = False
        self._find_switch(deadline)
        report = self._controller.status()
        if report.state != "Idle":
            raise self._motion.not_ready(report)
        self._controller.alarm = None
        self._controller.is_position_known = True
        self._home_position_mm = self._motion.machine_mm(report)

    def move_to(self, height_mm: float, timeout_s: float) -> float:
        """See `Stage.move_to`."""
        refuse_beyond_limits(height_mm, self.limits_mm)
        if self._is_moving:
            raise DeviceError(f"{self._controller.name} is moving already; nothing was sent")
        self._refuse_emergency()
        self._motion.is_stop_wanted = False
        deadline = self._clock() + timeout_s
        report = self._controller.status()
        # Where homing is required, Grbl is in alarm from the start, with nothing to clear.
        is_start = report.state == "Alarm" and self._controller.alarm is None
        if not self.is_homed and (report.state == "Idle" or is_start):
            raise StageNotHomedError(f"{self._controller.name} must be homed before it moves")
        if report.state != "Idle":
            raise self._motion.not_ready(report)
        stops_mm = approach_heights_mm(
            self._config,
            start_mm=self._motion.height_mm(report),
            target_mm=height_mm,
            is_flank_taken=self._is_flank_taken,
        )
        self._is_moving, self._is_flank_taken = True, False
        try:
            for stop_mm in stops_mm:
                self._motion.travel(self._motion.axis.machine_mm(stop_mm), deadline)
            read_back_mm = self._motion.settle(height_mm, deadline)
        except DeviceTimeoutError as error:
            raise DeviceTimeoutError(
                f"{self._controller.name} did not settle at {height_mm:g} mm within {timeout_s:g} s"
                f": {error}; {self._halt()}"
            ) from error
        except DeviceProtocolError as error:
            raise DeviceProtocolError(f"{error}; {self._halt()}") from error
        finally:
            self._is_moving = False
        self._is_flank_taken = True
        return read_back_mm

    def stop(self) -> None:
        """See `Stage.stop`. Homing cannot be stopped under control: it ends in a reset."""
        self._motion.is_stop_wanted = True
        self._is_flank_taken = False
        if self._is_homing:
            # At once: another thread may be in the dialogue until homing ends.
            self._controller.is_position_known = False
            self._controller.send_realtime(SOFT_RESET)
            self._is_homing = False
            self._motion.reset_after_failure()
        else:
            self._motion.cancel()

    def emergency_stop(self) -> None:
        """See `Stage.emergency_stop`; a reset, which leaves an alarm."""
        self._is_emergency = True
        self._is_homing = False
        self._motion.is_stop_wanted = True
        self._controller.is_position_known = False
        self._controller.lose_step()
        self._controller.send_realtime(SOFT_RESET)

    def clear_alarm(self) -> None:
        """See `Stage.clear_alarm`; a reset and an unlock. The position is void: home next."""
        self._is_homing = False
        self._controller.reset()
        report = self._controller.status()
        if report.state == "Alarm":
            answer = self._controller.command("$X")
            if answer.error is not None and answer.error.code not in UNLOCK_NEEDS_HOMING:
                raise self._motion.refused(answer.error.code)
        elif report.state != "Idle":
            raise self._motion.not_ready(report)
        self._is_emergency = False

    def close(self) -> None:
        """See `Stage.close`."""
        self._controller.close()

    def _find_switch(self, deadline: float) -> None:
        line = "$H" + (self._motion.axis.letter if self._config.homing == "single_axis" else "")
        # Stays set through a keyboard interrupt: `stop` must know that a jog cancel is not enough.
        self._is_homing = True
        try:
            answer = self._controller.command(line, max(deadline - self._clock(), 0.0))
        except (DeviceTimeoutError, DeviceProtocolError) as error:
            self._is_homing = False
            self._motion.reset_after_failure()
            raise type(error)(
                f"{self._controller.name} did not say that it is homed ({error}); it was reset: "
                "home it again"
            ) from error
        except DeviceError:
            self._is_homing = False
            raise
        self._is_homing = False
        if answer.error is not None:
            raise self._motion.refused(answer.error.code)

    def _check_reference(self, setup: GrblSetup, home_mm: float, deadline: float) -> None:
        self._is_moving, self._is_flank_taken = True, False
        self._motion.is_stop_wanted = False
        try:
            error_mm = reference_error_mm(
                self._motion,
                self._controller,
                setup,
                home_mm=home_mm,
                clock=self._clock,
                deadline=deadline,
            )
        except DeviceTimeoutError as error:
            raise DeviceTimeoutError(f"{error}; {self._halt()}") from error
        finally:
            self._is_moving = False
        self.reference_error_mm = error_mm
        if error_mm is not None and abs(error_mm) > SWITCH_TOLERANCE_MM:
            self.warnings = (
                f"the home switch answered {abs(error_mm):.2f} mm from where it should: the stage "
                "has lost steps, and heights since the homing before are wrong",
            )

    def _halt(self) -> str:
        """Stop after a failure, and say what came of it."""
        try:
            self.stop()
            if self.is_homed:
                height_mm = self._motion.height_mm(self._controller.status())
                return f"it was stopped at {height_mm:.3f} mm"
        except DeviceError as error:
            return f"stopping it failed: {error}"
        return "it was stopped"

    def _read_setup(self) -> GrblSetup:
        return check_settings(self._controller.settings(), self._config, name=self._controller.name)

    def _refuse_emergency(self) -> None:
        if self._is_emergency:
            raise StageAlarmError(
                f"{self._controller.name} was stopped in an emergency; clear the alarm, then home",
                code="emergency",
            )


def open_grbl_stage(
    config: StageConfig, *, first: Literal["nothing", "stop", "reset"] = "nothing"
) -> GrblStage:
    """Open the port of a bench file and begin the dialogue; moves nothing.

    Parameters
    ----------
    config
        The stage's section.
    first
        What to send before anything is asked: ``stop`` cancels a jog that another program left
        running, ``reset`` ends a state in which the controller answers no question.

    Raises
    ------
    DeviceError
        If the port cannot be opened or the controller is not as expected.
    """
    link = open_stage_link(config, name="the Grbl stage")
    stage = GrblStage(config, link, clock=monotonic, sleep=sleep)
    try:
        if first == "stop":
            link.write(JOG_CANCEL)
        stage.connect(reset=first == "reset")
    except BaseException:
        stage.close()
        raise
    return stage
