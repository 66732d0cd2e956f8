"""A Grbl firmware emulator, written from the published protocol.

It shares no code with the driver, so that a misreading in one is not hidden by the other.

References
----------
Grbl v1.1 documentation: "Grbl Interface Basics", "Jogging", "Real-time Commands", "Settings"
(gnea/grbl, doc/markdown). The ``grblhal`` dialect is grblHAL 1.1f.20260817 (grblHAL/core) as it
answered in its own simulator: fields and sub-states of reports, alarms that still answer questions,
lines of ``$I`` and ``$$``, homing, work envelope. ``grbl 0.9`` is only what gives it away.
"""

from dataclasses import dataclass

from hil_mocks.stages._grbl_protocol import (
    DEFAULT_SETTINGS,
    FACTORY_SETTINGS,
    GRBLHAL_SETTINGS,
    GREETINGS,
    STORED_LINES,
    WHEN_HOMING,
    GrblDialect,
    HomingCycle,
    HomingSettings,
    Reported,
    grbl_report,
    grblhal_report,
    old_report,
    read_jog,
    setting_lines,
    version_lines,
)
from hil_mocks.stages._plant import StagePlant, StepperAxis

LINE_CHARS = 80
NOT_IDLE, LOCKED, LINE_TOO_LONG, BEYOND_TRAVEL = 8, 9, 11, 15
LIMIT_PRESSED, UNLOCKS_BY_HOMING, BLOCKED = 45, 46, 79
HOMING_REQUIRED, LIMIT_AT_START = 11, 12

SINGLE_AXIS, HOMING_LOCK, SETS_ORIGIN = 2, 4, 8
"""Bits of grblHAL's ``$22``."""

QUESTIONS = ("$", "$$", "$I", "$G", "$#", "$N")


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblFaults:
    """Faults of the controller from now on."""

    hangs: bool = False  # neither obeys nor answers; a running move continues
    shows_state: str | None = None  # is in it and reports it: ``Hold:0``, ``Door:1``, ``Sleep``
    stops_short_mm: float = 0.0  # moves end before their target
    never_idle: bool = False  # reports never show the end of a move, which cannot be cancelled
    memory_is_blank: bool = False  # ``$$`` is answered ``error:7``
    adds_fields: str = ""  # as newer grblHAL does to every report: ``|$Q:1|New:a,b``


STEP_S = 0.004
"""Motion is computed in steps of this length."""

BOOT_S = 1.5
"""An AVR boot loader listens this long before Grbl starts."""

STRICT_HARD_LIMITS = 3
"""grblHAL's ``$21``: on, and the switches are looked at after a start."""

STARTS_IN_ALARM = 64
"""Number of grblHAL's setting for it."""


class GrblFirmware:
    """A controller driven by bytes and time; moves a plant along Z.

    ``dialect`` is ``grbl`` for Grbl 1.1h on an AVR board, ``grblhal``, or ``grbl 0.9``;
    ``settings`` replace individual `DEFAULT_SETTINGS`; ``work_offset_mm`` is one of Z left by
    another program; ``axes`` are the letters of all, of which Z moves.
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
        self.plant = plant
        own = GRBLHAL_SETTINGS if dialect == "grblhal" else {}
        self.settings = {**DEFAULT_SETTINGS, **own, **(settings or {})}
        self.is_homed = False
        self.lines_received: list[str] = []
        self.axis = StepperAxis(
            plant, steps_per_mm=self.settings[102], acceleration_mm_per_s2=self.settings[122]
        )
        self.axis.count_from(0.0)
        self._faults = GrblFaults()
        self._dialect = dialect
        self._work_offset_mm = work_offset_mm
        self._axes = axes
        self._state, self._alarm = self._cold_state()
        self._is_locked = self._is_report_due = self._tells_homed = False
        self._now_s = 0.0
        self._boots_at_s: float | None = None
        self._input = b""
        self._output: list[bytes] = []
        self._homing: HomingCycle | None = None
        self._reports = 0

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
                self.axis.rest(duration_s)
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

    @property
    def state(self) -> str:
        """Its present state."""
        return self._faults.shows_state or self._state

    def take_lines(self) -> list[bytes]:
        """See `Firmware.take_lines`."""
        lines, self._output = self._output, []
        return lines

    @property
    def _is_hal(self) -> bool:
        return self._dialect == "grblhal"

    @property
    def _is_pressed(self) -> bool:
        return self.plant.is_low_pressed or self.plant.is_high_pressed

    def _homing_has(self, bit: int) -> bool:
        return bool(int(self.settings[22]) & bit)

    @property
    def _sets_origin(self) -> bool:
        return self._is_hal and self._homing_has(SETS_ORIGIN)

    @property
    def _homes_down(self) -> bool:
        return bool(int(self.settings[23]) & 4)

    @property
    def _home_mm(self) -> float:
        """Position where homing ends."""
        if self._sets_origin:
            return 0.0
        pull_off, travel = self.settings[27], self.settings[132]
        return -travel + pull_off if self._homes_down else -pull_off

    def _is_beyond_travel(self, target_mm: float) -> bool:
        """Whether a jog is refused; grblHAL's keep off switches that would raise an alarm."""
        if not self.settings[20] or (self._is_hal and not self.is_homed):
            return False
        travel = self.settings[132]
        keep_off = self.settings[27] if self._is_hal and int(self.settings[21]) & 1 else 0.0
        if not self._sets_origin:
            return not -travel + keep_off <= target_mm <= -keep_off
        return not 0.0 <= (target_mm if self._homes_down else -target_mm) <= travel - keep_off

    def _say(self, text: str) -> None:
        if not self._faults.hangs:
            self._output.append(text.encode() + b"\r\n")

    def _run_stored_lines(self) -> None:
        for line in STORED_LINES:
            if line:
                self._say(f">{line}:ok")

    def _take_line(self, line: str) -> None:
        text = "".join(line.split()).upper()
        self.lines_received.append(text)
        error = LINE_TOO_LONG if len(line) >= LINE_CHARS else self._execute(text)
        if error is None:
            return
        if self._dialect == "grbl 0.9" and error:
            self._say("error: Invalid statement")
        else:
            self._say(f"error:{error}" if error else "ok")

    def _execute(self, text: str) -> int | None:
        """Return the error code, 0 for ok, None if the answer comes later."""
        at_rest = self.state in ("Idle", "Alarm")
        if not text:
            return 0
        if text.startswith("$J="):
            return self._jog(text[3:])
        if text.startswith("$H"):
            return self._home(text[2:]) if at_rest else NOT_IDLE
        if text == "$X":
            return self._unlock()
        if text == "$$":
            return self._print_settings()
        if text in QUESTIONS:
            return self._answer_question(text) if at_rest else NOT_IDLE
        if text.startswith("$") and "=" in text:
            return self._enter_setting(text) if at_rest else NOT_IDLE
        if text.startswith("$"):
            return BLOCKED if self._is_locked else 3
        return LOCKED if self.state in ("Alarm", "Jog") else 20

    def _answer_question(self, text: str) -> int:
        lines: list[str] = []
        if text == "$I":
            lines = version_lines(self._dialect, self.settings, self._axes)
        elif text == "$N":
            lines = [f"$N{number}={line}" for number, line in enumerate(STORED_LINES)]
        for line in lines:
            self._say(line)
        return 0

    def _jog(self, text: str) -> int:
        if self._is_locked:
            return BLOCKED
        if self.state not in ("Idle", "Jog"):
            return NOT_IDLE
        words = read_jog(text)
        if isinstance(words, int):
            return words
        target_mm = words.z_mm
        if words.is_incremental:
            target_mm += self.axis.counted_mm
        elif not words.is_machine:
            target_mm += self._work_offset_mm
        if self._is_beyond_travel(target_mm):
            return BEYOND_TRAVEL
        self.axis.go(target_mm, min(words.feed_mm_per_min, self.settings[112]) / 60)
        self._state = "Jog"
        return 0

    def _home(self, letters: str) -> int | None:
        if self._is_locked:
            return BLOCKED
        if not self._homing_has(1) or letters not in ("", "Z"):
            return 5
        if letters and not self._homing_has(SINGLE_AXIS):
            return 5
        self._start_homing()
        return None

    def _unlock(self) -> int:
        if self._is_locked:
            return BLOCKED
        if self._state != "Alarm":
            return 0
        if self._is_hal and self._alarm == LIMIT_AT_START and self._is_pressed:
            self._say("[MSG:Check Limits]")
            return LIMIT_PRESSED
        if self._is_hal and self._homing_has(HOMING_LOCK) and not self.is_homed:
            return UNLOCKS_BY_HOMING
        self._say("[MSG:Caution: Unlocked]")
        self._state, self._alarm = "Idle", 0
        return 0

    def _print_settings(self) -> int:
        if self._faults.memory_is_blank:
            return 7
        for line in setting_lines(self.settings, self._dialect):
            self._say(line)
        return 0

    def _enter_setting(self, text: str) -> int:
        name, _, value = text[1:].partition("=")
        try:
            number, entered = int(name), float(value)
        except ValueError:
            return 2
        if number not in self.settings:
            return 3
        if number == 20 and entered and not self._homing_has(1):
            return 10
        self.settings[number] = entered
        return 0
