"""A Grbl firmware emulator, written from the published protocol.

It shares no code with the driver, so that a misreading in one is not hidden by the other.

References
----------
Grbl v1.1 documentation: "Grbl Interface Basics", "Jogging", "Real-time Commands", "Settings"
(gnea/grbl, doc/markdown). For the ``grblhal`` dialect: banner, ``H:`` field, sub-states of
alarms, reports while homing, work envelope with hard limits.
"""

from dataclasses import dataclass

from hil_mocks.stages.grbl_homing import HomingCycle, HomingSettings
from hil_mocks.stages.grbl_lines import (
    DEFAULT_SETTINGS,
    FACTORY_SETTINGS,
    MM_PER_INCH,
    GrblDialect,
    read_jog,
    setting_lines,
    version_lines,
)
from hil_mocks.stages.plant import StagePlant
from hil_mocks.stages.stepper_axis import StepperAxis

STEP_S = 0.004
"""Motion is computed in steps of this length."""

BOOT_S = 1.5
"""An AVR boot loader listens this long before Grbl starts."""

LINE_CHARS = 80
NOT_IDLE, LINE_TOO_LONG, BEYOND_TRAVEL = 8, 11, 15


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblFaults:
    """Faults of the controller from now on.

    Parameters
    ----------
    hangs
        It neither obeys nor answers; a running move continues.
    shows_state
        It is in this state and reports it, such as ``Hold:0``, ``Door:1`` or ``Sleep``.
    stops_short_mm
        Moves end before their target.
    never_idle
        Its reports never show the end of a move, and the move cannot be cancelled.
    memory_is_blank
        ``$$`` is answered ``error:7``.
    """

    hangs: bool = False
    shows_state: str | None = None
    stops_short_mm: float = 0.0
    never_idle: bool = False
    memory_is_blank: bool = False


class GrblFirmware:
    """A controller driven by bytes and time; moves a plant along Z.

    Parameters
    ----------
    plant
        The mechanics.
    dialect
        ``grbl`` for Grbl 1.1h on an AVR board, ``grblhal`` for grblHAL.
    settings
        Replacements for individual `DEFAULT_SETTINGS`.
    work_offset_mm
        A work offset of Z left by another program.
    """

    def __init__(
        self,
        plant: StagePlant,
        *,
        dialect: GrblDialect = "grbl",
        settings: dict[int, float] | None = None,
        work_offset_mm: float = 0.0,
    ) -> None:
        self.plant = plant
        self.settings = {**DEFAULT_SETTINGS, **(settings or {})}
        self.is_homed = False
        self._faults = GrblFaults()
        self._dialect = dialect
        self._work_offset_mm = work_offset_mm
        self._now_s = 0.0
        self._boots_at_s: float | None = None
        self._state = "Alarm" if self._homing_bits & 1 else "Idle"
        self._alarm = 11 if self._state == "Alarm" else 0
        self._is_locked = False
        self._input = b""
        self._output: list[bytes] = []
        self._homing: HomingCycle | None = None
        self._reports = 0
        self.lines_received: list[str] = []
        self.axis = StepperAxis(
            plant,
            steps_per_mm=self.settings[102],
            acceleration_mm_per_s2=self.settings[122],
        )
        self.axis.count_from(0.0)

    @property
    def faults(self) -> GrblFaults:
        """Its faults."""
        return self._faults

    @faults.setter
    def faults(self, faults: GrblFaults) -> None:
        self._faults = faults
        self.axis.stops_short_mm = faults.stops_short_mm
        self.axis.ignores_brake = faults.never_idle

    @property
    def state(self) -> str:
        """Its present state."""
        return self._faults.shows_state or self._state

    def power_cycle(self, boot_s: float = BOOT_S) -> None:
        """Restart, as after a brown-out, a reset button or the opening of an AVR's port."""
        self.axis.halt()
        self.axis.count_from(0.0)
        self._homing = None
        self._input = b""
        self._output.clear()
        self._is_locked = False
        self.is_homed = False
        self._state, self._alarm = ("Alarm", 11) if self._homing_bits & 1 else ("Idle", 0)
        self._boots_at_s = self._now_s + boot_s
        if boot_s == 0.0:
            self._greet()

    def lose_settings(self) -> None:
        """Forget the entered settings."""
        self.settings = dict(FACTORY_SETTINGS)

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

    def take_lines(self) -> list[bytes]:
        """See `Firmware.take_lines`."""
        lines, self._output = self._output, []
        return lines

    @property
    def _homing_bits(self) -> int:
        return int(self.settings[22])

    def _say(self, text: str) -> None:
        if not self._faults.hangs:
            self._output.append(text.encode("ascii") + b"\r\n")

    def _greet(self) -> None:
        self._boots_at_s = None
        name = "GrblHAL 1.1f" if self._dialect == "grblhal" else "Grbl 1.1h"
        self._say("")
        self._say(f"{name} ['$' for help]")
        if self._state == "Alarm":
            self._say("[MSG:'$H'|'$X' to unlock]")

    def _step(self, duration_s: float) -> None:
        if self._boots_at_s is not None and self._now_s >= self._boots_at_s:
            self._greet()
        self.axis.advance(duration_s)
        if self._homing is not None:
            self._step_homing()
        elif self._state == "Jog":
            is_pressed = self.plant.is_low_pressed or self.plant.is_high_pressed
            if int(self.settings[21]) & 1 and is_pressed:
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
        inverted = int(self.settings[23]) & 4
        pull_off, travel = self.settings[27], self.settings[132]
        self.axis.count_from(-travel + pull_off if inverted else -pull_off)
        self._state, self._alarm, self.is_homed = "Idle", 0, True
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
            self._report(everything=value == 0x87)
        elif value == 0x85:
            if self._state == "Jog":
                self.axis.brake()
        elif value >= 0x80 or value in b"!~" or self._is_locked:
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
        self._homing = None
        self.axis.halt()
        self._is_locked = False
        self.is_homed = False
        self._reports = 0
        self._greet()

    def _take_line(self, line: str) -> None:
        text = "".join(line.split()).upper()
        self.lines_received.append(text)
        error = LINE_TOO_LONG if len(line) >= LINE_CHARS else self._execute(text)
        if error is None:
            return
        self._say(f"error:{error}" if error else "ok")

    def _execute(self, text: str) -> int | None:
        """Return the error code, 0 for ok, None if the answer comes later."""
        at_rest = self.state in ("Idle", "Alarm")
        if not text:
            return 0
        if text.startswith("$J="):
            return self._jog(text[3:])
        if text.startswith("$H"):
            return self._start_homing(text[2:]) if at_rest else NOT_IDLE
        if text == "$X":
            return self._unlock()
        if text == "$$":
            return self._print_settings()
        if text == "$I":
            return self._print_version() if at_rest else NOT_IDLE
        if text in ("$", "$G", "$#", "$N"):
            return 0 if at_rest else NOT_IDLE
        if text.startswith("$") and "=" in text:
            return self._enter_setting(text) if at_rest else NOT_IDLE
        if text.startswith("$"):
            return 3
        return 9 if self.state in ("Alarm", "Jog") else 20

    def _jog(self, text: str) -> int:
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
        if self.settings[20] and not self._low_end <= target_mm <= self._high_end:
            return BEYOND_TRAVEL
        self.axis.go(target_mm, min(words.feed_mm_per_min, self.settings[112]) / 60)
        self._state = "Jog"
        return 0

    @property
    def _keep_off(self) -> float:
        """Distance that grblHAL's jogs keep from switches that would raise an alarm."""
        is_hal = self._dialect == "grblhal"
        return self.settings[27] if is_hal and int(self.settings[21]) & 1 else 0.0

    @property
    def _low_end(self) -> float:
        return -self.settings[132] + self._keep_off

    @property
    def _high_end(self) -> float:
        return -self._keep_off

    def _start_homing(self, letters: str) -> int | None:
        bits = self._homing_bits
        if not bits & 1 or (letters and not bits & 2) or letters not in ("", "Z"):
            return 5
        self._state, self.is_homed = "Home", False
        self._homing = HomingCycle(self.axis, self.plant, HomingSettings.of(self.settings))
        return None

    def _unlock(self) -> int:
        if self._state != "Alarm":
            return 0
        if self._dialect == "grblhal" and self._homing_bits & 4 and not self.is_homed:
            return 46
        self._say("[MSG:Caution: Unlocked]")
        self._state, self._alarm = "Idle", 0
        return 0

    def _print_settings(self) -> int:
        if self._faults.memory_is_blank:
            return 7
        for line in setting_lines(self.settings, self._dialect):
            self._say(line)
        return 0

    def _print_version(self) -> int:
        for line in version_lines(self._dialect):
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
        if number == 20 and entered and not self._homing_bits & 1:
            return 10
        self.settings[number] = entered
        return 0

    def _report(self, *, everything: bool) -> None:
        is_hal = self._dialect == "grblhal"
        if not is_hal and (self._homing is not None or self._is_locked or everything):
            return
        state = self.state
        if self._faults.never_idle and state == "Idle":
            state = "Jog"
        if is_hal and state == "Alarm" and everything:
            state = f"Alarm:{self._alarm}"
        unit = 1 / MM_PER_INCH if self.settings[13] else 1.0
        shows_machine = int(self.settings[10]) & 1
        shift = 0.0 if shows_machine else self._work_offset_mm
        height = (self.axis.counted_mm - shift) * unit
        fields = [state, f"{'MPos' if shows_machine else 'WPos'}:0.000,0.000,{height:.3f}"]
        feed = self.axis.speed_mm_per_s * 60 * unit
        fields.append(f"Bf:15,128|FS:{feed:.0f},0")
        if self.plant.is_low_pressed or self.plant.is_high_pressed:
            fields.append("Pn:Z")
        if self._reports % 10 == 0 or everything:
            fields.append(f"WCO:0.000,0.000,{self._work_offset_mm * unit:.3f}")
        elif self._reports % 10 == 1:
            fields.append("Ov:100,100,100")
        if everything:
            fields.append(f"H:{int(self.is_homed)}|FW:grblHAL")
        self._reports += 1
        self._say(f"<{'|'.join(fields)}>")
