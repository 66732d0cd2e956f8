"""A Grbl firmware emulator, written from the published protocol.

It shares no code with the driver, so that a misreading in one is not hidden by the other.

References
----------
Grbl v1.1 documentation: "Grbl Interface Basics", "Jogging", "Real-time Commands", "Settings"
(gnea/grbl, doc/markdown). The ``grblhal`` dialect is grblHAL 1.1f.20260817 (grblHAL/core) as it
answered in its own simulator: fields and sub-states of reports, alarms that still answer questions,
lines of ``$I`` and ``$$``, homing, work envelope. ``grbl 0.9`` is only what gives it away.
"""

from hil_mocks.stages.grbl_commands import (
    HOMING_LOCK,
    HOMING_REQUIRED,
    LIMIT_AT_START,
    GrblCommands,
    GrblFaults,
)
from hil_mocks.stages.grbl_homing import HomingCycle, HomingSettings
from hil_mocks.stages.grbl_lines import FACTORY_SETTINGS, GREETINGS, GrblDialect
from hil_mocks.stages.grbl_reports import (
    WHEN_HOMING,
    Reported,
    grbl_report,
    grblhal_report,
    old_report,
)
from hil_mocks.stages.plant import StagePlant

__all__ = ["GrblFaults", "GrblFirmware"]

STEP_S = 0.004
"""Motion is computed in steps of this length."""

BOOT_S = 1.5
"""An AVR boot loader listens this long before Grbl starts."""

STRICT_HARD_LIMITS = 3
"""grblHAL's ``$21``: on, and the switches are looked at after a start."""

STARTS_IN_ALARM = 64
"""Number of grblHAL's setting for it."""


class GrblFirmware(GrblCommands):
    """A controller driven by bytes and time; moves a plant along Z.

    Parameters
    ----------
    plant, dialect, settings, work_offset_mm, axes
        See `GrblCommands`.
    """

    def __init__(
        self,
        plant: StagePlant,
        *,
        dialect: GrblDialect = "grbl",
        settings: dict[int, float] | None = None,
        work_offset_mm: float = 0.0,
        axes: str = "XYZ",
    ) -> None:
        super().__init__(
            plant, dialect=dialect, settings=settings, work_offset_mm=work_offset_mm, axes=axes
        )
        self._now_s = 0.0
        self._boots_at_s: float | None = None
        self._state, self._alarm = self._cold_state()
        self._input = b""
        self._homing: HomingCycle | None = None
        self._reports = 0
        self._is_report_due = self._tells_homed = False

    @property
    def faults(self) -> GrblFaults:
        """Its faults."""
        return self._faults

    @faults.setter
    def faults(self, faults: GrblFaults) -> None:
        self._faults = faults
        self.axis.stops_short_mm = faults.stops_short_mm
        self.axis.ignores_brake = faults.never_idle

    def power_cycle(self, boot_s: float = BOOT_S) -> None:
        """Restart, as after a brown-out, a reset button or the opening of an AVR's port."""
        self.axis.halt()
        self.axis.count_from(0.0)
        self._homing = None
        self._input = b""
        self._output.clear()
        self._is_locked = False
        self.is_homed = False
        self._state, self._alarm = self._cold_state()
        self._boots_at_s = self._now_s + boot_s
        if boot_s == 0.0:
            self._greet()

    def lose_settings(self) -> None:
        """Forget the entered settings."""
        self.settings |= FACTORY_SETTINGS

    def press_reset(self) -> None:
        """Press the button beside the board."""
        self._soft_reset()

    def raise_alarm(self, code: int) -> None:
        """Enter an alarm, as by an emergency stop button."""
        self._enter_alarm(code, is_critical=code in (1, 2, 10))

    def receive(self, data: bytes) -> None:
        """See `Firmware.receive`."""
        for value in data:
            if self._boots_at_s is None and not self._faults.hangs:
                self._take_byte(value)

    def advance(self, now_s: float) -> None:
        """See `Firmware.advance`."""
        while self._now_s < now_s:
            duration_s = min(STEP_S, now_s - self._now_s)
            if not self.axis.is_moving and self._homing is None and self._boots_at_s is None:
                duration_s = now_s - self._now_s  # nothing happens meanwhile
                self._creep(duration_s)
            self._now_s += duration_s
            self.plant.now_s = self._now_s
            self._step(duration_s)

    def _cold_state(self) -> tuple[str, int]:
        """State and alarm after power-up."""
        if not self._is_hal:
            return ("Alarm", HOMING_REQUIRED) if self._homing_has(1) else ("Idle", 0)
        if self._homing_has(HOMING_LOCK):
            return "Alarm", HOMING_REQUIRED
        return ("Alarm" if self.settings[STARTS_IN_ALARM] else "Idle"), 0

    def _greet(self) -> None:
        self._boots_at_s = None
        self._say("")
        self._say(GREETINGS[self._dialect])
        is_strict = int(self.settings[21]) & STRICT_HARD_LIMITS == STRICT_HARD_LIMITS
        if self._is_hal and self._homing_has(HOMING_LOCK) and not self.is_homed:
            self._raise_at_start(HOMING_REQUIRED, "Homing cycle required")
        elif self._is_hal and is_strict and self._is_pressed:
            self._raise_at_start(LIMIT_AT_START, "Check Limits")
        elif self._state == "Alarm":
            self._say("[MSG:'$H'|'$X' to unlock]")
        elif self._is_hal:
            self._run_stored_lines()

    def _raise_at_start(self, code: int, message: str) -> None:
        self._state, self._alarm = "Alarm", code
        self._say(f"ALARM:{code}")
        self._say(f"[MSG:{message}]")

    def _step(self, duration_s: float) -> None:
        if self._boots_at_s is not None and self._now_s >= self._boots_at_s:
            self._greet()
        self.axis.advance(duration_s)
        if self._homing is not None:
            self._step_homing()
        elif self._state == "Jog":
            if int(self.settings[21]) & 1 and self._is_pressed:
                self.axis.halt()
                self._enter_alarm(1, is_critical=True)
            elif not self.axis.is_moving and not self._faults.never_idle:
                self._state = "Idle"

    def _creep(self, duration_s: float) -> None:
        faults = self.plant.faults
        sunk_mm = faults.creep_mm_per_s * duration_s
        if sunk_mm:
            self.plant.sink(sunk_mm)
            if faults.creep_is_seen:
                self.axis.shift(-sunk_mm)

    @property
    def _is_silent_while_homing(self) -> bool:
        return not (self._is_hal and int(self.settings[10]) & WHEN_HOMING)

    def _start_homing(self) -> None:
        self._state, self.is_homed = "Home", False
        if self._is_hal and self._is_silent_while_homing:
            self._report(everything=False)
        self._homing = HomingCycle(self.axis, self.plant, HomingSettings.of(self.settings))

    def _step_homing(self) -> None:
        outcome = self._homing.step() if self._homing else None
        if outcome is None:
            return
        self._homing = None
        if outcome:
            self._enter_alarm(outcome, is_critical=False)
            self.is_homed = False
            self._greet()
            return
        self.axis.count_from(self._home_mm)
        self._state, self._alarm, self.is_homed = "Idle", 0, True
        if self._is_hal:
            self._tells_homed = True
            if self._is_report_due:
                self._report(everything=False)
            self._say("[MSG:]")
            self._run_stored_lines()
        self._say("ok")

    def _enter_alarm(self, code: int, *, is_critical: bool) -> None:
        self._state, self._alarm = "Alarm", code
        self._say(f"ALARM:{code}")
        if is_critical:
            self._is_locked = True
            self._say("[MSG:Reset to continue]")

    def _take_byte(self, value: int) -> None:
        if value == 0x18:
            self._soft_reset()
        elif value in (0x3F, 0x80, 0x87):
            self._answer_query(everything=value == 0x87)
        elif value == 0x85:
            if self._state == "Jog":
                self.axis.brake()
        elif value >= 0x80 or value in b"!~" or (self._is_locked and not self._is_hal):
            return
        elif value in b"\r\n":
            line, self._input = self._input.decode("ascii"), b""
            self._take_line(line)
        else:
            self._input += bytes([value])

    def _soft_reset(self) -> None:
        self._input = b""
        if self._homing is not None:
            self._enter_alarm(6, is_critical=False)
        elif self._state == "Jog":
            self._enter_alarm(3, is_critical=False)
        # grblHAL still knows where it is if it stood.
        self.is_homed = self.is_homed and self._is_hal and self._state != "Alarm"
        self._homing = None
        self.axis.halt()
        self._is_locked = self._is_report_due = False
        self._reports = 0
        self._greet()

    def _answer_query(self, *, everything: bool) -> None:
        if self._homing is not None and self._is_silent_while_homing:
            self._is_report_due = self._is_hal
        elif self._is_hal or not (self._is_locked or everything):
            self._report(everything=everything)

    def _report(self, *, everything: bool) -> None:
        state = self.state
        if self._faults.never_idle and state == "Idle":
            state = "Jog"
        seen = Reported(
            state=state,
            alarm=self._alarm,
            height_mm=self.axis.counted_mm,
            work_offset_mm=self._work_offset_mm,
            feed_mm_per_min=self.axis.speed_mm_per_s * 60,
            is_pressed=self._is_pressed,
            is_homed=self.is_homed,
            is_blocked=self._is_locked,
            settings=self.settings,
            count=self._reports,
            axes=self._axes,
            everything=everything,
        )
        self._reports += 1
        self._is_report_due = False
        if self._is_hal:
            adds = self._faults.adds_fields
            self._say(grblhal_report(seen, adds_homed=self._tells_homed, adds=adds))
            self._tells_homed = False
        else:
            self._say(old_report(seen) if self._dialect == "grbl 0.9" else grbl_report(seen))
